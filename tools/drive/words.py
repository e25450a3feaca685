"""The words of the prompt and of the command line, together."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType

from hm_driver.protocol.commands import VERBS
from tools.drive import language
from tools.drive.device_words import device_words, send
from tools.drive.language import Argument, Call, Word, number
from tools.drive.mode_words import mode_words
from tools.drive.motion_words import motion_words
from tools.drive.options import DriveOptions
from tools.drive.showing import wait
from tools.drive.surface import Context

_PASSIVE = ("help", "quit", "exit")


def build_words(options: DriveOptions) -> Mapping[str, Word[Context]]:
    """The language, with the ranges of a configuration."""
    words = [*motion_words(options), *mode_words(), *device_words(), *_other_words()]
    return MappingProxyType({word.name: word for word in words})


def needs_device(line: list[str]) -> bool:
    """Whether the words of a command can only be carried out with a device."""
    return line[0] not in _PASSIVE and line[:2] != ["effect", "types"]


def check(words: Mapping[str, Word[Context]], line: list[str]) -> None:
    """Refuse a command that cannot be read, before anything is done.

    Raises:
        ConfigurationError: What is wrong with it.
    """
    if line[0] not in VERBS:
        language.read(language.find(words, line[0]), line[1:])


def carry_out(context: Context, line: list[str]) -> Word[Context] | None:
    """Carry one command out, in our language or in the device's own; returns the word.

    Raises:
        HapticMasterError: It failed, or was refused.
        KeyboardInterrupt: Ctrl-C; `MotionStopped` where it stopped a motion.
    """
    if context.opened is not None:
        context.opened.log.event("command", " ".join(line))
    if line[0] in VERBS:
        send(context, " ".join(line))
        return None
    word = language.find(context.words, line[0])
    word.run(context, language.read(word, line[1:]))
    return word


def _other_words() -> Iterable[Word[Context]]:
    yield Word(
        name="wait",
        doc="Wait, for scripts; the arm stays as it is.",
        run=lambda context, call: wait(context, call.number("S")),
        arguments=(number("S", "time", "s", 0.0, 86400.0),),
    )
    yield Word(
        name="help",
        doc="Explain a word, or list them all.",
        run=_help,
        arguments=(Argument(name="WORD", doc="the word", is_optional=True),),
    )
    for name in ("quit", "exit"):
        yield Word(name=name, doc="End, with the arm stopped (as Ctrl-D).", run=_quit)


def _help(context: Context, call: Call) -> None:
    name = call.text("WORD")
    if name in VERBS:
        name = "raw"
    if name:
        context.console.write(language.find(context.words, name).help())
        return
    context.console.write_rows([(word.usage, "") for word in context.words.values() if word.name != "exit"])
    context.console.write("'help WORD' explains one, with units and ranges.")


def _quit(context: Context, _call: Call) -> None:
    context.is_over = True
