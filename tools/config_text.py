"""A configuration written out again: as a plain tree, and as TOML that reads back to the same values."""

import ast
import dataclasses
import inspect
import itertools
import json
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tools.config_types import NONE_WORD

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def to_dict(value: "DataclassInstance") -> dict[str, Any]:
    """Tree of TOML's own types; an enum becomes its value, a path text, None the word ``"none"``."""
    return {
        field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value) if field.init
    }


def to_toml(value: "DataclassInstance", *, comments: Mapping[str, str] | None = None) -> str:
    """TOML text that `tools.config.load` reads back to an equal value.

    Args:
        value: The configuration.
        comments: Text to write behind the line of a dotted key, such as the source of its value.
    """
    lines: list[str] = []
    _write_table(lines, to_dict(value), "", "", (comments or {}).get)
    return "\n".join(lines).strip() + "\n"


def field_docs(cls: "type[DataclassInstance]") -> dict[str, str]:
    """First paragraph under each field of a dataclass, on one line; empty where the source is not at hand."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(cls)))
    except (OSError, TypeError, SyntaxError):
        return {}
    docs: dict[str, str] = {}
    body = tree.body[0].body if isinstance(tree.body[0], ast.ClassDef) else []
    for statement, following in itertools.pairwise(body):
        if (
            isinstance(statement, ast.AnnAssign)
            and isinstance(statement.target, ast.Name)
            and isinstance(following, ast.Expr)
            and isinstance(following.value, ast.Constant)
            and isinstance(following.value.value, str)
        ):
            docs[statement.target.id] = " ".join(following.value.value.partition("\n\n")[0].split())
    return docs


def documentation(value: "DataclassInstance", place: str = "") -> dict[str, str]:
    """Docstring of every field inside a configuration, by dotted key."""
    docs = {f"{place}{name}": text for name, text in field_docs(type(value)).items()}
    for field in dataclasses.fields(value):
        inner = getattr(value, field.name)
        if is_dataclass(inner) and not isinstance(inner, type):
            docs |= documentation(inner, f"{place}{field.name}.")
    return docs


def _plain(value: object) -> object:
    if value is None:
        return NONE_WORD
    if is_dataclass(value) and not isinstance(value, type):
        return to_dict(value)
    if isinstance(value, Enum):
        return _plain(value.value)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value


def _write_table(
    lines: list[str], table: dict[str, Any], heading: str, place: str, comment: Callable[[str], str | None]
) -> None:
    """Values first, as TOML asks, then the tables inside."""
    for key, item in table.items():
        if not isinstance(item, dict) and not _is_array_of_tables(item):
            note = comment(f"{place}{key}")
            lines.append(f"{key} = {_inline(item)}" + (f"  # {note}" if note else ""))
    for key, item in table.items():
        if isinstance(item, dict):
            lines += ["", f"[{heading}{key}]"]
            _write_table(lines, item, f"{heading}{key}.", f"{place}{key}.", comment)
        elif _is_array_of_tables(item):
            for index, element in enumerate(item):
                lines += ["", f"[[{heading}{key}]]"]
                _write_table(lines, element, f"{heading}{key}.", f"{place}{key}[{index}].", comment)


def _is_array_of_tables(item: object) -> bool:
    return isinstance(item, list) and bool(item) and all(isinstance(element, dict) for element in item)


def _inline(item: object) -> str:
    if isinstance(item, bool):
        return "true" if item else "false"
    if isinstance(item, str):
        return json.dumps(item, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(item, list):
        return "[" + ", ".join(map(_inline, item)) + "]"
    if isinstance(item, dict):
        return "{" + ", ".join(f"{key} = {_inline(value)}" for key, value in item.items()) + "}"
    return repr(item)
