"""``hm drive``: drive the device from the command line and from a prompt."""

import contextlib
import inspect
import re
import signal
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from cyclopts import Parameter

from tools.cli.console import tell, write

if TYPE_CHECKING:
    from hm_driver.geometry import ArmGeometry
    from tools.check.first_run import Approach
    from tools.drive.options import DriveOptions
    from tools.drive.session import Drive
    from tools.drive.surface import Context

_SWITCH = Parameter(negative="")
_HELP_FLAGS = frozenset({"--help", "-h"})
_PATIENT = {"missed_s": 0.0, "freeze_s": 2.0, "heartbeat_s": 2.0, "exchange_timeout_s": 2.0}


class Place(NamedTuple):
    """What is driven."""

    device: str | None
    world: str | None
    yes: bool
    """Whether the first run on a robot was confirmed on the command line."""


def drive(
    *words: Annotated[str, Parameter(allow_leading_hyphen=True)],
    device: str | None = None,
    control: Literal["spring", "bias"] | None = None,
    record: Path | None = None,
    config: Path | None = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative="")] = None,
    world: str | None = None,
    yes_real_robot: Annotated[bool, _SWITCH] = False,
) -> int:
    """Drive the device: show its state, move it, hold it, let effects act on it, record.

    With WORDS one command is carried out (or several with ';' in quotes), without them a prompt opens; lines
    from a pipe are carried out one by one, up to the first that fails. The words are the same everywhere:
    hm drive help lists them, hm drive help goto explains one. Without --device an emulator is started.

    Every motion runs below the loop's limits. However it ends, the device is left in state stop, unless
    nothing but questions was asked. Exit codes: 0 ok, 1 a check failed or the device refused
    what was typed, 2 usage, 3 the device, the link or the loop failed, 130 interrupted.

    Args:
        words: A command, as in: goto 0.05 0 0.1 --speed 0.05.
        device: Address of a HapticMASTER or of an emulator, tcp://HOST[:7654].
        control: What position mode pulls with: a moving spring of the device, or a bias force by the loop.
        record: Record all of it into this log (MCAP).
        config: TOML file with the tables motion, modes, limits, timing, watch.
        set_: A value over the file's, as in motion.speed=0.05; may be given again.
        world: World endpoint of the emulator at --device, the second line that hm emulate prints. Without it
            the device is taken for a robot, whose first run is confirmed, slow and weak.
        yes_real_robot: Confirm that first run without being asked.
    """
    from tools.cli.failures import ExitCode
    from tools.drive import language
    from tools.drive.console import Console
    from tools.drive.showing import stay
    from tools.drive.surface import Context
    from tools.drive.words import build_words, carry_out, check, needs_device

    options = _options(config, set_ or [], control)
    table = build_words(options)
    if words and set(words) <= _HELP_FLAGS:
        write(_explanation())
    lines = language.commands(" ".join(_as_told(words)))
    for line in lines:
        check(table, line)
    context = Context(console=Console(), words=table, is_one_shot=bool(lines))
    if lines and not any(needs_device(line) for line in lines):
        for line in lines:
            carry_out(context, line)
        return ExitCode.OK
    place = Place(device=device, world=world, yes=yes_real_robot)
    with _ending_at_once(), _opened(context, place, options, record):
        try:
            if not lines:
                _talk(context)
            for line in lines:
                context.is_followed = line is not lines[-1]
                word = carry_out(context, line)
            if lines and word is not None and word.stays and not _is_bounded(line):
                stay(context)
        finally:
            context.console.clear()
    return ExitCode.OK


def _as_told(words: tuple[str, ...]) -> list[str]:
    """The words; asking for help in the usual way is the word for it."""
    asked = [word for word in words if word not in _HELP_FLAGS]
    return asked if len(asked) == len(words) else ["help", *asked[:1]]


def _explanation() -> str:
    """What ``hm drive --help`` says before the words."""
    text, _, arguments = (inspect.getdoc(drive) or "").partition("\nArgs:\n")
    lines = [
        re.sub(r"^    ([a-z_]+):", lambda match: f"    --{match[1].rstrip('_').replace('_', '-')}:", line)
        for line in arguments.split("\n")
    ]
    usage = "usage: hm drive [WORDS] [OPTIONS]"
    return "\n".join([usage, "", text.strip(), "", "Options:", *lines, "", "Words:"]).replace(
        "--words:", "WORDS:"
    )


def _is_bounded(line: list[str]) -> bool:
    """Whether a command that stays has said how long, or only shown something."""
    is_change = line[0] != "state" or line[1:2] in (["force"], ["position"])
    is_made = line[0] != "effect" or (line[1:2] == ["create"] and "--enable" in line)
    is_begun = line[:2] != ["record", "stop"]
    return any(part.startswith("--seconds") for part in line) or not (is_change and is_made and is_begun)


def _options(config: Path | None, overrides: list[str], control: str | None) -> "DriveOptions":
    from tools.config import load, parse_overrides
    from tools.drive.mode_words import CONTROLS
    from tools.drive.options import DriveOptions

    options = load(DriveOptions, config, parse_overrides(overrides))
    if control is None:
        return options
    return replace(options, modes=replace(options.modes, position_control=CONTROLS[control]))


@contextlib.contextmanager
def _opened(
    context: "Context", place: Place, options: "DriveOptions", record: Path | None
) -> Iterator["Drive"]:
    """A device, or an emulator of our own, and a drive of it."""
    from tools.drive.log import DriveLog
    from tools.drive.session import Drive

    device = place.device
    with contextlib.ExitStack() as stack:
        if device is None:
            from emulator.process import Emulator

            tell("starting an emulator; the first start compiles its model, which takes up to half a minute")
            emulator = stack.enter_context(Emulator(init_seconds=1.0))
            device = emulator.url
            options = replace(options, watch=replace(options.watch, **_PATIENT))
        log = stack.enter_context(DriveLog(device, options))
        if record is not None:
            log.start(record)
        approach = _Approaching(context, place)
        driver = Drive(device, options, log, tell=context.console.tell, approach=approach)
        driver.on_progress = lambda: context.console.draw(lambda: driver.status().line())
        context.opened = stack.enter_context(driver)
        yield driver
    if driver.engine.has_driven and not driver.engine.has_failed:
        approach.completed()


class _Approaching:
    """Asks, before anything is commanded, whether a device that may be a robot shall be driven."""

    def __init__(self, context: "Context", place: Place) -> None:
        self._context = context
        self._place = place
        self._approach: Approach | None = None

    def __call__(self, options: "DriveOptions", geometry: "ArmGeometry") -> "DriveOptions":
        """The configuration to go on with."""
        from tools.cli.approach import approach_at_terminal
        from tools.drive.words import build_words

        place = self._place
        if place.device is None:
            return options
        self._approach = approach_at_terminal(place.device, world=place.world, yes=place.yes)
        modes, limits = self._approach.reduce(options.modes, options.limits, geometry)
        reduced = replace(
            options, motion=options.motion.below(limits.reference_speed), modes=modes, limits=limits
        )
        self._context.words = build_words(reduced)
        return reduced

    def completed(self) -> None:
        """Remember that a first run has ended in order."""
        if self._approach is not None:
            self._approach.completed()


def _talk(context: "Context") -> None:
    """Read commands from the terminal, or from whatever standard input is."""
    from tools.cli.failures import show_failure
    from tools.drive.script import run_script

    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        run_script(context, sys.stdin)
        return
    from tools.drive.prompt import Prompt

    prompt = Prompt(context, show_failure=show_failure)
    context.drive.on_failure = prompt.notice
    prompt.run()


@contextlib.contextmanager
def _ending_at_once() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the program where Ctrl-C only stops a motion."""
    from tools.drive.outcome import EndRequested

    def end(_signal: int, _frame: FrameType | None) -> None:
        raise EndRequested

    before = {}
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            before[number] = signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
