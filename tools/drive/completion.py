"""What could come next on a line: candidates for completion, and a hint of what a word takes."""

import os
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from hm_driver.protocol.commands import VERBS
from hm_driver.protocol.vocabulary import OBJECT_TYPES, QUANTITIES, SETTABLE_QUANTITIES, SETTABLE_STATES
from tools.drive.effect_words import ACTIONS
from tools.drive.effects import EffectTable
from tools.drive.language import Argument, Word, tokens
from tools.drive.surface import Context


class Candidate(NamedTuple):
    """One way to go on."""

    text: str
    """What would stand in place of the last, unfinished word of the line."""
    doc: str = ""


def unfinished(line: str) -> tuple[list[str], str]:
    """The finished words of a line's last command, and the one that is being typed, perhaps empty."""
    parts = tokens(line)
    last = parts.pop() if parts and not line.endswith((" ", ";")) else ""
    while ";" in parts:
        parts = parts[parts.index(";") + 1 :]
    return parts, "" if last == ";" else last


def candidates(line: str, words: Mapping[str, Word[Context]], table: EffectTable) -> list[Candidate]:
    """Ways to go on behind a line, those alone that fit what is typed already."""
    before, last = unfinished(line)
    if not before:
        found = [Candidate(word.name, word.doc) for word in words.values()]
        found += [Candidate(verb, "the device's own language") for verb in VERBS]
    elif before[0] == "raw":
        found = list(_raw(before[1:], table)) if before[1:] else [Candidate(verb) for verb in VERBS]
    elif before[0] in VERBS:
        found = list(_raw(before, table))
    elif before[0] == "effect":
        found = list(_effect(before[1:], table))
    elif before[0] in words:
        found = list(_arguments(words[before[0]], before[1:], last, words))
    else:
        found = []
    return [candidate for candidate in found if candidate.text.startswith(last)]


def hint(line: str, words: Mapping[str, Word[Context]]) -> str:
    """What the word on a line takes, with the unit and range of the argument that comes next."""
    before, last = unfinished(line)
    name = before[0] if before else last
    if name in VERBS:
        return _RAW_USAGE[name]
    if name not in words:
        return ""
    word = words[name]
    plain = [part for part in before[1:] if not part.startswith("--")]
    following = _next_argument(word, len(plain)) if before else None
    if following is None or not following.is_number:
        return f"{word.usage}   {word.doc}"
    return f"{word.usage}   {following.name}: {following.doc}, {following.expected()}"


_RAW_USAGE = {
    "get": "get QUANTITY | get NAME PARAMETER",
    "set": "set QUANTITY VALUE | set NAME PARAMETER VALUE | set NAME enable|disable",
    "create": "create TYPE NAME",
    "remove": "remove NAME | remove all",
    "calibrateforcesensor": "calibrateforcesensor   takes the force measured now for zero",
}


def _arguments(
    word: Word[Context], given: list[str], last: str, words: Mapping[str, Word[Context]]
) -> Iterable[Candidate]:
    option = next((option for option in word.options if given and option.name == given[-1]), None)
    if option is not None and option.value is not None:
        yield from _values(option.value, last)
        return
    if last.startswith("-"):
        yield from (Candidate(option.name, option.doc) for option in word.options)
        return
    plain = [part for part in given if not part.startswith("--")]
    argument = _next_argument(word, len(plain))
    if argument is not None:
        yield from _values(argument, last)
    if word.name == "help" and not given:
        yield from (Candidate(other.name, other.doc) for other in words.values())
    if word.name == "record" and not given:
        yield Candidate("stop", "end the log")
    if not last:
        yield from (Candidate(option.name, option.doc) for option in word.options if option.name not in given)


def _next_argument(word: Word[Context], count: int) -> Argument | None:
    if count < len(word.arguments):
        return word.arguments[count]
    return word.arguments[-1] if word.arguments and word.arguments[-1].is_repeated else None


def _values(argument: Argument, last: str) -> Iterable[Candidate]:
    if argument.is_path:
        yield from _paths(last)
    yield from (Candidate(choice) for choice in argument.choices)


def _paths(last: str) -> Iterable[Candidate]:
    directory, _, _ = last.rpartition("/")
    shown = f"{directory}/" if "/" in last else ""
    try:
        with os.scandir(os.path.expanduser(shown or ".")) as entries:  # noqa: PTH111 - a text, not yet a path
            found = sorted((entry.name, entry.is_dir()) for entry in entries)
    except OSError:
        return
    for name, is_directory in found:
        if not name.startswith(".") and (is_directory or name.endswith((".csv", ".mcap"))):
            yield Candidate(shown + name + ("/" if is_directory else ""))


def _effect(given: list[str], table: EffectTable) -> Iterable[Candidate]:
    if not given:
        yield from (Candidate(action) for action in ACTIONS)
        return
    action = given[0]
    if action in ("create", "types") and len(given) == 1:
        yield from (Candidate(kind.name, kind.doc) for kind in OBJECT_TYPES.values())
    elif action in ("set", "enable", "disable", "remove") and len(given) == 1:
        yield from _objects(table)
        if action == "remove":
            yield Candidate("all")
    elif action == "create" and len(given) > 2 and given[1] in OBJECT_TYPES:
        yield from _parameters(given[1], "=")
        yield Candidate("--enable", "render it at once")
    elif action == "set" and len(given) > 1 and given[1] in table.objects:
        yield from _parameters(table.objects[given[1]].type.name, "=")


def _raw(given: list[str], table: EffectTable) -> Iterable[Candidate]:
    verb, count = given[0], len(given)
    if count == 1 and verb == "get":
        yield from (Candidate(name, quantity.doc) for name, quantity in QUANTITIES.items())
        yield from _objects(table)
    elif count == 1 and verb == "set":
        yield from (Candidate(name, QUANTITIES[name].doc) for name in SETTABLE_QUANTITIES)
        yield from _objects(table)
    elif count == 1 and verb == "create":
        yield from (Candidate(kind.name, kind.doc) for kind in OBJECT_TYPES.values())
    elif count == 1 and verb == "remove":
        yield from _objects(table)
        yield Candidate("all")
    elif count == 2 and given[:2] == ["set", "state"]:
        yield from (Candidate(state) for state in SETTABLE_STATES)
    elif count == 2 and verb in ("get", "set") and given[1] in table.objects:
        yield from _parameters(table.objects[given[1]].type.name, "")
        yield from (Candidate(word) for word in (("enable", "disable") if verb == "set" else ("enabled",)))


def _objects(table: EffectTable) -> Iterable[Candidate]:
    return (Candidate(name, known.type.name) for name, known in table.objects.items())


def _parameters(kind: str, behind: str) -> Iterable[Candidate]:
    return (
        Candidate(f"{parameter.name}{behind}", f"{parameter.doc}: {parameter.expected()}")
        for parameter in OBJECT_TYPES[kind].parameters.values()
    )
