"""Columns as comma-separated values: one line a message, numbers with all their digits."""

import csv
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from google.protobuf.json_format import MessageToDict

from hm_driver.recording.decoding import Columns

if TYPE_CHECKING:
    from tools.log.export import Table


def write(path: Path, table: "Table", pieces: Iterator[Columns]) -> int:
    """Write a table; returns the number of its messages.

    Lists become JSON, bytes become hexadecimal digits.
    """
    turns = [_turner(kind) for kind in table.kinds.values()]
    rows = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table.columns)
        for piece in pieces:
            columns = [
                values.tolist() if turn is None else [turn(one) for one in values]
                for turn, values in zip(turns, piece.values(), strict=True)
            ]
            writer.writerows(zip(*columns, strict=True))
            rows += len(columns[0])
    return rows


def _turner(kind: str) -> Callable[[Any], str] | None:
    """What makes text of a value; None where the value is text or a number."""
    if kind == "bytes":
        return bytes.hex
    if kind in ("message list", "bytes list"):
        return as_json
    return _list_as_json if kind.endswith(" list") else None


def _list_as_json(values: Any) -> str:  # noqa: ANN401 - a list or an array
    return json.dumps(values if isinstance(values, list) else values.tolist())


def as_json(values: list[Any]) -> str:
    """A list of messages, or of bytes, as JSON."""
    return json.dumps(
        [
            one.hex() if isinstance(one, bytes) else MessageToDict(one, preserving_proto_field_name=True)
            for one in values
        ]
    )
