"""``hm config``: what a session would run with, and why."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from tools.cli.console import write, write_json
from tools.config import DEFAULT, parse_overrides
from tools.config_text import documentation, to_dict, to_toml


def show(
    *,
    config: Path | None = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative="")] = None,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Print the merged configuration as TOML that can be used as a file again.

    Behind each value stands what it means and, where it is not the default, its source.

    Args:
        config: TOML file.
        set_: A value over the file's, as in learner.w_gen=0.7; may be given again.
        json: One JSON object instead: the values, and the source of each by dotted name.
    """
    from tools.run.options import load_options

    merged = load_options(config, parse_overrides(set_ or []))
    if json:
        write_json({"values": to_dict(merged.value), "sources": dict(merged.sources)})
        return
    comments = _comments(merged.sources, documentation(merged.value))
    write(to_toml(merged.value, comments=comments).rstrip())


def _comments(sources: Mapping[str, str], docs: Mapping[str, str]) -> dict[str, str]:
    comments = {}
    for key, source in sources.items():
        origin = "" if source == DEFAULT else f"[{source}] "
        comments[key] = (origin + docs.get(key, "")).strip()
    return comments
