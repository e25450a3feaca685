"""The language of the prompt as data: words, their arguments with unit and range, and how a line is read.

One table serves the prompt, piped lines and the command line; completion and help are made from it too.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from hm_driver.errors import ConfigurationError
from hm_driver.protocol.commands import VERBS
from tools.config_types import suggestion

C = TypeVar("C")

_FEW_CHOICES = 3
"""So many choices are shown in a usage instead of a name for them."""

_TOKEN = re.compile(r"""(?:[^\s\["';]|\[[^\]]*\]?|"[^"]*"?|'[^']*'?)+|;""")


@dataclass(frozen=True, slots=True, kw_only=True)
class Argument:
    """A value that a word takes."""

    name: str
    """What the usage calls it."""
    doc: str
    is_number: bool = False
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    is_range_checked: bool = True
    """Whether the reader refuses what is out of range; else whoever carries it out does."""
    choices: tuple[str, ...] = ()
    """The words that are accepted; none for any."""
    is_optional: bool = False
    is_repeated: bool = False
    """Takes all that is left; at the end only."""
    is_path: bool = False

    def read(self, field_name: str, text: str) -> str | float:
        """The value that a text is.

        Raises:
            ConfigurationError: It is none, or out of range; names field, value and limit.
        """
        if self.choices and text not in self.choices:
            near = suggestion(text, self.choices).rstrip("?").replace("; did", ": did")
            raise ConfigurationError(field_name, f"{text!r} is none of {' '.join(self.choices)}{near}")
        return self._number(field_name, text) if self.is_number else text

    def _number(self, field_name: str, text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value) or "_" in text:
            raise ConfigurationError(field_name, f"{text!r} is no number; accepted: {self.expected()}")
        if self.is_range_checked and not self.low <= value <= self.high:
            raise ConfigurationError(field_name, f"{value:g} {self.unit} is out of range: {self.expected()}")
        return value

    def expected(self) -> str:
        """What is accepted, in words."""
        if self.choices:
            return " ".join(self.choices)
        if not self.is_number:
            return self.name
        low, high = math.isfinite(self.low), math.isfinite(self.high)
        if low and high:
            return f"{self.low:.3g} to {self.high:.3g} {self.unit}".rstrip()
        return f"a number in {self.unit}" if self.unit else "a number"


def number(name: str, doc: str, unit: str, low: float, high: float, *, refused: bool = True) -> Argument:
    """An argument that is a number with a unit and a range."""
    return Argument(
        name=name, doc=doc, is_number=True, unit=unit, low=low, high=high, is_range_checked=refused
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """Something that may be said beside the arguments: ``--speed 0.1``, or ``--json`` alone."""

    name: str
    """With its dashes."""
    doc: str
    value: Argument | None = None
    """None for a switch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Word(Generic[C]):
    """A word of the language."""

    name: str
    doc: str
    """One line."""
    run: Callable[[C, "Call"], None]
    arguments: tuple[Argument, ...] = ()
    options: tuple[Option, ...] = ()
    more: str = ""
    """More to know, for the word's own help."""
    stays: bool = False
    """On the command line, what it brought about stays until Ctrl-C."""

    @property
    def usage(self) -> str:
        """The word with its arguments and options."""
        parts = [self.name]
        for argument in self.arguments:
            few = 0 < len(argument.choices) <= _FEW_CHOICES
            shown = "|".join(argument.choices) if few else argument.name
            shown += " ..." if argument.is_repeated else ""
            parts.append(f"[{shown}]" if argument.is_optional else shown)
        for option in self.options:
            value = "" if option.value is None else f" {option.value.name}"
            parts.append(f"[{option.name}{value}]")
        return " ".join(parts)

    def help(self) -> str:
        """All there is to know of it, with units and ranges."""
        rows = [(argument.name, _describe(argument)) for argument in self.arguments]
        for option in self.options:
            value = "" if option.value is None else f" {option.value.name}"
            what = option.doc if option.value is None else f"{option.doc} ({option.value.expected()})"
            rows.append((option.name + value, what))
        width = max((len(name) for name, _ in rows), default=0)
        lines = [self.usage, f"    {self.doc}", *(f"    {name:<{width}}  {text}" for name, text in rows)]
        return "\n".join([*lines, *(f"    {line}" for line in self.more.splitlines())])


@dataclass(frozen=True, slots=True)
class Call:
    """A word with what was said to it."""

    word: str
    values: Mapping[str, str | float] = field(default_factory=dict)
    """Arguments and options by name."""
    rest: tuple[str, ...] = ()
    """Values of the argument that takes all that is left."""

    def number(self, name: str, default: float = math.nan) -> float:
        """A number that was said, or the default."""
        value = self.values.get(name, default)
        return value if isinstance(value, float) else default

    def text(self, name: str, default: str = "") -> str:
        """A text that was said, or the default."""
        return str(self.values.get(name, default))

    def has(self, name: str) -> bool:
        """Whether it was said."""
        return name in self.values


def tokens(line: str) -> list[str]:
    """Split a line at blanks; what stands in brackets or quotes stays together.

    >>> tokens("effect set wall pos=[0, 0, 0.1]; hold")
    ['effect', 'set', 'wall', 'pos=[0, 0, 0.1]', ';', 'hold']
    """
    return [match.group() for match in _TOKEN.finditer(line)]


def commands(line: str) -> list[list[str]]:
    """Split a line of several commands at ``;``; what stands behind a ``#`` is left out."""
    groups: list[list[str]] = [[]]
    for part in tokens(line):
        if part.startswith("#"):
            break
        if part == ";":
            groups.append([])
        else:
            groups[-1].append(part)
    return [group for group in groups if group]


def find(words: Mapping[str, Word[C]], name: str) -> Word[C]:
    """Look a word up.

    Raises:
        ConfigurationError: There is none of that name; names the nearest.
    """
    if name in words:
        return words[name]
    near = suggestion(name, (*words, *VERBS)) or ";"
    raise ConfigurationError(name, f"unknown word{near} 'help' lists all")


def read(word: Word[C], given: Sequence[str]) -> Call:
    """Read what was said to a word.

    Raises:
        ConfigurationError: Something is missing, too much, of the wrong kind or out of range.
    """
    values: dict[str, str | float] = {}
    plain: list[str] = []
    waiting = list(given)
    while waiting:
        token = waiting.pop(0)
        if token.startswith("--"):
            _read_option(word, token, waiting, values)
        else:
            plain.append(_unquoted(token))
    rest: tuple[str, ...] = ()
    for argument in word.arguments:
        if argument.is_repeated:
            rest, plain = tuple(plain), []
            if not rest and not argument.is_optional:
                raise _missing(word, argument)
            for text in rest:
                argument.read(f"{word.name} {argument.name}", text)
        elif plain:
            values[argument.name] = argument.read(f"{word.name} {argument.name}", plain.pop(0))
        elif not argument.is_optional:
            raise _missing(word, argument)
    if plain:
        raise ConfigurationError(word.name, f"{plain[0]!r} is too much; usage: {word.usage}")
    return Call(word.name, values, rest)


def _missing(word: Word[C], argument: Argument) -> ConfigurationError:
    return ConfigurationError(word.name, f"{argument.name} is missing; usage: {word.usage}")


def _read_option(word: Word[C], token: str, waiting: list[str], values: dict[str, str | float]) -> None:
    name, equals, text = token.partition("=")
    option = next((option for option in word.options if option.name == name), None)
    if option is None:
        names = [option.name for option in word.options]
        near = suggestion(name, names).rstrip("?")
        accepted = " ".join(names) or "none"
        raise ConfigurationError(word.name, f"unknown option {name}{near}; accepted: {accepted}")
    if option.value is None:
        if equals:
            raise ConfigurationError(f"{word.name} {name}", "takes no value")
        values[name] = "true"
        return
    if not equals:
        if not waiting:
            raise ConfigurationError(f"{word.name} {name}", f"needs a value: {option.value.expected()}")
        text = waiting.pop(0)
    values[name] = option.value.read(f"{word.name} {name}", _unquoted(text))


def _unquoted(token: str) -> str:
    if len(token) > 1 and token[0] == token[-1] and token[0] in "\"'":
        return token[1:-1]
    return token


def _describe(argument: Argument) -> str:
    if argument.choices or argument.is_number:
        return f"{argument.doc} ({argument.expected()})"
    return argument.doc
