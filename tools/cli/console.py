"""What commands write: results on standard output, everything else on standard error."""

import json
import sys
from collections.abc import Iterable, Mapping


def write(text: str) -> None:
    """Write a line of the result."""
    sys.stdout.write(f"{text}\n")


def write_json(value: Mapping[str, object]) -> None:
    """Write the result as one JSON object on one line, keys in their given order.

    Raises:
        ValueError: A number in it is not finite, which JSON cannot say; give null instead.
    """
    write(json.dumps(value, allow_nan=False, ensure_ascii=False))


def write_table(rows: Iterable[tuple[str, str]]) -> None:
    """Write names and values in two columns."""
    rows = list(rows)
    width = max((len(name) for name, _ in rows), default=0)
    for name, value in rows:
        write(f"{name:<{width}}  {value}".rstrip())


def tell(text: str) -> None:
    """Tell the user something that is no result."""
    sys.stderr.write(f"{text}\n")
    sys.stderr.flush()
