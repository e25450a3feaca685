"""Configuration: a TOML file and command-line overrides become nested frozen dataclasses, or a clear error.

The dataclasses are the schema: their fields name the keys, their annotations the types, their defaults the
values where nothing is given, and their ``__post_init__`` the ranges. Values come from, in rising order,
the defaults, the file, the overrides. Nothing is ignored: a key that no field answers to is refused.

A preset is a set of defaults that goes by one name: it stands between the defaults and the file.

Types a field may have: ``float``, ``int``, ``bool``, ``str``, ``Path``, an ``Enum`` (by value or name), a
``Literal``, a dataclass (a table), ``tuple[X, ...]`` (an array; of dataclasses: an array of tables),
``tuple[X, Y]``, and any of them ``| None``, where the word ``"none"`` stands for None, as TOML has no null.
A relative path in a file starts at the file's directory, one on the command line at the working directory.

>>> from dataclasses import dataclass
>>> @dataclass(frozen=True, kw_only=True)
... class Learner:
...     w_gen: float = 0.8
>>> @dataclass(frozen=True, kw_only=True)
... class Options:
...     seed: int = 1
...     learner: Learner = Learner()
>>> load(Options, None, {"learner.w_gen": "0.7"})
Options(seed=1, learner=Learner(w_gen=0.7))
>>> load(Options, None, {"learner.w_gne": "0.7"})
Traceback (most recent call last):
hm_driver.errors.ConfigurationError: command line: learner.w_gne: no such key; did you mean learner.w_gen?
"""

import dataclasses
import tomllib
import typing
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, dataclass, is_dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, NoReturn, TypeVar

from hm_driver.errors import ConfigurationError
from tools.config_types import MisfitError, convert, element_types, suggestion, table_type

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

T = TypeVar("T", bound="DataclassInstance")

COMMAND_LINE = "command line"
"""Source of a value that an override gave."""
DEFAULT = "default"
"""Source of a value that nobody gave."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Merged(Generic[T]):
    """A configuration, and where each of its values came from."""

    value: T
    """The configuration itself."""
    sources: Mapping[str, str]
    """For each dotted key: the file's name, `COMMAND_LINE` or `DEFAULT`."""


class Presets(NamedTuple):
    """Sets of defaults, one of which the configuration chooses itself."""

    key: str
    """Key of the first level whose value names the set."""
    values: Mapping[str, Mapping[str, object]]
    """By name: TOML's own value by dotted key. No set for a name: nothing but the defaults."""


def load(
    cls: type[T],
    path: Path | None = None,
    overrides: Mapping[str, str] | None = None,
    *,
    presets: Presets | None = None,
) -> T:
    """Build a configuration from defaults, a TOML file and overrides.

    Args:
        cls: The dataclass that is the schema.
        path: The file; None for none.
        overrides: Dotted key to text, as in ``--set learner.w_gen=0.7``.
        presets: Sets of defaults to choose from.

    Raises:
        ConfigurationError: An unknown key, a wrong type, a value out of range, a missing value, or a file
            that cannot be read; it names the dotted field and the file.
    """
    return merge(cls, path, overrides, presets=presets).value


def merge(
    cls: type[T],
    path: Path | None = None,
    overrides: Mapping[str, str] | None = None,
    *,
    presets: Presets | None = None,
) -> Merged[T]:
    """As `load`, but also say where each value came from.

    Raises:
        ConfigurationError: As for `load`.
    """
    reader = _Reader(path)
    tree = _read_file(path) if path is not None else {}
    for key, text in (overrides or {}).items():
        _plant(tree, key, _Text(text))
    chosen = _chosen(cls, tree, presets) if presets is not None else {}
    base = _Reader(None).table(cls, _nested(chosen), "", None) if chosen else None
    value = reader.table(cls, tree, "", base)
    if presets is not None:
        name = f"{presets.key} {_plain(getattr(value, presets.key))}"
        reader.sources.update({key: name for key in chosen if reader.sources.get(key) == DEFAULT})
    return Merged(value=value, sources=reader.sources)


def _chosen(cls: type[T], tree: Mapping[str, Any], presets: Presets) -> Mapping[str, object]:
    """The set of defaults that the configuration names; none if the name is wrong, which is refused later."""
    field = next(field for field in dataclasses.fields(cls) if field.name == presets.key)
    raw = tree.get(presets.key, _plain(_default(field)))
    name = _as_toml(raw) if isinstance(raw, _Text) else raw
    return presets.values.get(name, {}) if isinstance(name, str) else {}


def _nested(values: Mapping[str, object]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for key, value in values.items():
        *tables, leaf = key.split(".")
        node = tree
        for name in tables:
            node = node.setdefault(name, {})
        node[leaf] = value
    return tree


def _plain(value: object) -> object:
    return value.value if isinstance(value, Enum) else value


def parse_overrides(assignments: Iterable[str]) -> dict[str, str]:
    """Split the arguments of ``--set``, each ``dotted.key=value``; of two for one key the last holds.

    Raises:
        ConfigurationError: An argument without ``=`` or without a key.
    """
    overrides: dict[str, str] = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals or not key.strip():
            raise ConfigurationError(
                "--set", f"{assignment!r} is not of the form key=value, as in learner.w_gen=0.7"
            )
        overrides[key.strip()] = text.strip()
    return overrides


class _Text(str):
    """Text of a command line: its type is still to be read from the field that it is for."""

    __slots__ = ()


def _read_file(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ConfigurationError(
            "file", f"cannot be read: {error.strerror or error}", source=str(path)
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigurationError("file", "is not UTF-8 text", source=str(path)) from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError("file", f"is not valid TOML: {error}", source=str(path)) from error


def _plant(tree: dict[str, Any], key: str, text: _Text) -> None:
    """Put the text of an override into the tree of the file, over what was there."""
    *tables, leaf = key.split(".")
    node = tree
    for depth, name in enumerate(tables, start=1):
        node = node.setdefault(name, {})
        if not isinstance(node, dict):
            place = ".".join(tables[:depth])
            raise ConfigurationError(
                key,
                f"{place} is not a table, so nothing inside it can be set; set {place} as a whole",
                source=COMMAND_LINE,
            )
    node[leaf] = text


class _Reader:
    """Turns a tree of TOML values into dataclasses, and notes where each value came from."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.sources: dict[str, str] = {}

    def table(self, cls: type[T], tree: Mapping[str, Any], place: str, base: T | None) -> T:
        """Build one dataclass from a table; `base` has the values of the fields that the table leaves out."""
        hints = typing.get_type_hints(cls)
        fields = {field.name: field for field in dataclasses.fields(cls) if field.init}
        for key in tree:
            if key not in fields:
                self._refuse_unknown(key, tree[key], place, fields)
        arguments: dict[str, Any] = {}
        for name, field in fields.items():
            dotted = f"{place}.{name}" if place else name
            default = getattr(base, name) if base is not None else _default(field)
            if name in tree:
                arguments[name] = self._value(hints[name], tree[name], dotted, default)
            elif default is MISSING:
                raise ConfigurationError(dotted, "is missing and has no default", source=self._file())
            else:
                arguments[name] = default
                self._note_defaults(default, dotted)
        try:
            return cls(**arguments)
        except ConfigurationError as error:
            dotted = f"{place}.{error.field}" if place else error.field
            raise ConfigurationError(dotted, error.problem, source=self._source_of(dotted)) from error

    def _value(self, hint: object, raw: object, dotted: str, default: object) -> object:
        cls = table_type(hint)
        if isinstance(raw, dict) and cls is not None:
            return self.table(cls, raw, dotted, default if isinstance(default, cls) else None)
        if not isinstance(raw, _Text):
            self.sources[dotted] = self._file()
            return self._given(hint, raw, dotted, self._file())
        self.sources[dotted] = COMMAND_LINE
        parsed = _as_toml(raw)
        try:
            return self._given(hint, parsed, dotted, COMMAND_LINE)
        except ConfigurationError:
            if type(parsed) is str:
                raise
            try:  # 007 for a field of text: not the number that TOML would read
                return self._given(hint, str(raw), dotted, COMMAND_LINE)
            except ConfigurationError:
                pass
            raise

    def _given(self, hint: object, raw: object, place: str, source: str) -> object:
        cls = table_type(hint)
        if isinstance(raw, dict) and cls is not None and source != COMMAND_LINE:
            return self.table(cls, raw, place, None)
        if isinstance(raw, list) and (hints := element_types(hint, len(raw))) is not None:
            if len(hints) != len(raw):
                problem = f"has {len(raw)} elements where {len(hints)} are needed"
                raise ConfigurationError(place, problem, source=source)
            items = enumerate(zip(hints, raw, strict=True))
            return tuple(
                self._given(inner, item, f"{place}[{index}]", source) for index, (inner, item) in items
            )
        directory = self._path.parent if self._path is not None and source != COMMAND_LINE else None
        try:
            return convert(hint, raw, directory)
        except MisfitError as error:
            problem = f"{error}; set its keys one by one, as in {place}.key=value" if cls else str(error)
            raise ConfigurationError(place, problem, source=source) from error

    def _note_defaults(self, value: object, dotted: str) -> None:
        if is_dataclass(value):
            for field in dataclasses.fields(value):
                self._note_defaults(getattr(value, field.name), f"{dotted}.{field.name}")
        else:
            self.sources[dotted] = DEFAULT

    def _refuse_unknown(self, key: str, raw: object, place: str, known: Iterable[str]) -> NoReturn:
        prefix = f"{place}." if place else ""
        names = list(known)
        hint = suggestion(key, names, prefix) or f"; known here: {', '.join(names)}"
        while isinstance(raw, dict) and len(raw) == 1:  # [lerner] with one key: name what the user wrote
            inner, raw = next(iter(raw.items()))
            key = f"{key}.{inner}"
        source = COMMAND_LINE if isinstance(raw, _Text) else self._file()
        raise ConfigurationError(f"{prefix}{key}", f"no such key{hint}", source=source)

    def _source_of(self, dotted: str) -> str:
        """Where a refused value came from; for a default, where what it was checked against did."""
        table = dotted.rpartition(".")[0]
        for place in (dotted, table):
            inside = {
                source
                for key, source in self.sources.items()
                if not place or key == place or key.startswith((f"{place}.", f"{place}["))
            }
            for source in (COMMAND_LINE, self._file()):
                if source in inside:
                    return source
        return ""

    def _file(self) -> str:
        return str(self._path) if self._path is not None else COMMAND_LINE


def _default(field: "dataclasses.Field[Any]") -> object:
    return field.default_factory() if field.default_factory is not MISSING else field.default


def _as_toml(text: str) -> object:
    """Read an override as TOML where that gives a value, else as the bare word that it is."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return str(text)
