"""What one value of a configuration may be: whether it fits its annotation, and the words that refuse it."""

import difflib
import math
import types
import typing
from collections.abc import Iterable
from dataclasses import is_dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

NONE_WORD = "none"
"""Stands for None in a field that may be None: TOML has no null."""

_PLAIN = {float: "a finite number", int: "a whole number", bool: "true or false", str: "text", Path: "a path"}


class MisfitError(ValueError):
    """A value that does not fit; the text says what would."""


def alternatives(hint: object) -> tuple[object, ...]:
    """The members of a union, or the type itself."""
    return typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else (hint,)


def table_type(hint: object) -> "type[DataclassInstance] | None":
    """The dataclass that a table of TOML becomes, if the annotation names one."""
    for member in alternatives(hint):
        if isinstance(member, type) and is_dataclass(member):
            return member
    return None


def element_types(hint: object, length: int) -> tuple[object, ...] | None:
    """The type of each element of an array of this length, if the annotation allows an array."""
    for member in alternatives(hint):
        if typing.get_origin(member) is tuple:
            arguments = typing.get_args(member)
            return arguments[:1] * length if arguments[-1] is Ellipsis else arguments
    return None


def convert(hint: object, raw: object, directory: Path | None) -> object:
    """Turn a value of TOML that is neither table nor array into what a field holds.

    Args:
        hint: The field's annotation.
        raw: The value as TOML gave it.
        directory: Where a relative path starts; None for the working directory.

    Raises:
        MisfitError: It is nothing that the annotation allows.
    """
    if raw == NONE_WORD and types.NoneType in alternatives(hint):
        return None
    for member in alternatives(hint):
        try:
            return _convert_to(member, raw, directory)
        except MisfitError:
            continue
    raise MisfitError(f"must be {describe(hint)}, not {_quote(raw)}{suggestion(raw, _choices(hint))}")


def describe(hint: object) -> str:
    """What a field takes, in words."""
    members = alternatives(hint)
    if len(members) > 1:
        return " or ".join(describe(member) for member in members)
    if hint is types.NoneType:
        return f'"{NONE_WORD}"'
    if choices := _choices(hint):
        return "one of " + ", ".join(choices)
    if typing.get_origin(hint) is tuple:
        inner, *rest = typing.get_args(hint)
        return f"an array of {describe(inner)}" if rest == [...] else f"an array of {1 + len(rest)} values"
    if isinstance(hint, type):
        return _PLAIN.get(hint, f"a table ({hint.__name__})")
    return str(hint)


def suggestion(word: object, known: Iterable[str], prefix: str = "") -> str:
    """``; did you mean …?``, or nothing where no known word is near."""
    near = difflib.get_close_matches(str(word), list(known), n=1, cutoff=0.5)
    return f"; did you mean {prefix}{near[0]}?" if near else ""


def _convert_to(hint: object, raw: object, directory: Path | None) -> object:
    if typing.get_origin(hint) is Literal:
        for choice in typing.get_args(hint):
            if type(choice) is type(raw) and choice == raw:
                return choice
    elif isinstance(hint, type) and issubclass(hint, Enum):
        for member in hint:
            if (type(member.value) is type(raw) and member.value == raw) or member.name == raw:
                return member
    elif hint is float and isinstance(raw, int | float) and not isinstance(raw, bool):
        return _finite(raw)
    elif hint is Path and isinstance(raw, str) and raw:
        return directory / raw if directory is not None else Path(raw)
    elif hint in (int, bool, str) and type(raw) is hint:
        return raw
    raise MisfitError


def _finite(raw: float) -> float:
    try:
        number = float(raw)
    except OverflowError as error:
        raise MisfitError from error
    if not math.isfinite(number):
        raise MisfitError
    return number


def _choices(hint: object) -> list[str]:
    found: list[str] = []
    for member in alternatives(hint):
        if typing.get_origin(member) is Literal:
            found += map(str, typing.get_args(member))
        elif isinstance(member, type) and issubclass(member, Enum):
            found += (str(choice.value) for choice in member)
    return found


def _quote(raw: object) -> str:
    if isinstance(raw, bool):
        return "true" if raw else "false"
    if isinstance(raw, str):
        return f'"{raw}"'
    if isinstance(raw, dict):
        return "a table"
    return "an array" if isinstance(raw, list) else str(raw)[:60]
