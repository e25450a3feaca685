"""The words about the device itself: its states, its limits, its log, its own language."""

import math
import time
from collections.abc import Iterable
from pathlib import Path

from hm_driver.errors import ConfigurationError
from hm_driver.protocol.commands import VERBS
from hm_driver.protocol.vocabulary import State
from tools.drive.effect_words import effect_word
from tools.drive.language import Argument, Call, Option, Word, number
from tools.drive.log import free_log
from tools.drive.mode_words import say_mode
from tools.drive.reach import bounding_box
from tools.drive.showing import SECONDS, wait, watch
from tools.drive.surface import Context

_STATES = ("stop", "force", "position", "init", "home", "off")


def device_words() -> Iterable[Word[Context]]:
    """The words."""
    yield Word(
        name="state",
        doc="Show the state live until Ctrl-C, or put the device into another one.",
        run=_state,
        arguments=(Argument(name="STATE", doc="state", choices=_STATES, is_optional=True),),
        options=(
            Option(name="--once", doc="one look"),
            Option(name="--json", doc="JSON, an object a line"),
            SECONDS,
            Option(name="--rate", doc="looks in a second", value=number("HZ", "rate", "Hz", 0.1, 100.0)),
        ),
        more=(
            "In a pipe, and with a command behind it, it shows one look unless --seconds says how long.\n"
            "force: answers to the hand where it is released. position: does not respond to the hand, and\n"
            "drives to where goto, jog and run lead it. init and home move the arm by themselves."
        ),
        stays=True,
    )
    yield Word(name="stop", doc="End the loop gently; the device goes to state stop.", run=_stop)
    yield effect_word()
    yield Word(
        name="record",
        doc="Record a log (MCAP): begins, and ends with 'record stop'.",
        run=_record,
        arguments=(
            Argument(
                name="FILE", doc="the log; 'stop' ends it; a name is made without", is_optional=True,
                is_path=True,
            ),
        ),
        options=(
            Option(name="--output", doc="the log", value=Argument(name="FILE", doc="the log", is_path=True)),
            SECONDS,
        ),
        more="On the command line the arm is held meanwhile, unless another command stands before it.",
        stays=True,
    )  # fmt: skip
    yield Word(name="limits", doc="Show the workspace and the limits that hold.", run=_limits)
    yield Word(
        name="raw",
        doc="Send a line of the device's own language; those verbs work without 'raw' too.",
        run=lambda context, call: send(context, " ".join(call.rest)),
        arguments=(Argument(name="COMMAND", doc=f"begins with {', '.join(VERBS)}", is_repeated=True),),
        more="As in: get measpos; set state force; create spring s1; set s1 stiffness 200",
    )


def _state(context: Context, call: Call) -> None:
    drive, console = context.drive, context.console
    if call.has("STATE"):
        state = State(call.text("STATE"))
        if state in (State.INIT, State.HOME):
            console.tell("the arm moves by itself, and no loop of ours watches it: keep your hands off")
        drive.enter(state)
        console.write(f"state {drive.arm.state.value}")
        if state in (State.FORCE, State.POSITION):
            say_mode(context)
        return
    if call.has("--once") or (context.is_followed and not call.has("--seconds")):
        status = drive.status()
        if drive.is_driving and not status.rate_hz:  # a rate needs two looks
            time.sleep(0.12)
            status = drive.status()
        if call.has("--json"):
            console.write_json(status.as_dict())
        else:
            console.write_rows(status.rows())
        return
    watch(
        context,
        call.number("--seconds", math.inf),
        as_json=call.has("--json"),
        rate_hz=call.number("--rate", 0.0),
    )


def _stop(context: Context, _call: Call) -> None:
    context.drive.stop()
    context.console.write("state stop")


def _record(context: Context, call: Call) -> None:
    drive, console = context.drive, context.console
    name = call.text("--output") or call.text("FILE")
    if call.has("--output") and call.has("FILE"):
        raise ConfigurationError("record", "the log is named twice: FILE and --output")
    if name == "stop":
        path = drive.log.path
        status = drive.log.finish()
        lost = f", {status.lost} lost" if status.lost else ""
        console.write(f"{path}: {status.messages} messages{lost}")
        return
    drive.log.start(Path(name).expanduser() if name else free_log(Path.cwd()))
    console.write(f"recording {drive.log.path}")
    if drive.is_driving:
        drive.restart_loop()
    elif context.is_one_shot or call.has("--seconds"):
        drive.hold()
    else:
        console.tell("the log begins with the loop: 'hold' or 'release' next")
    if call.has("--seconds"):
        wait(context, call.number("--seconds"))
        status = drive.log.finish()
        console.write(f"{status.path}: {status.messages} messages")


def _limits(context: Context, _call: Call) -> None:
    options, geometry = context.drive.options, context.drive.geometry
    limits = options.limits
    speeds = (
        f"r {limits.velocity_r:g} m/s, phi {limits.velocity_phi:g} rad/s, z {limits.velocity_z:g} m/s; "
        f"the arm is stopped at {limits.velocity_trip:g} times as much"
    )
    forces = (
        f"{options.modes.position_force_max:g} N a spring; the arm is stopped when the hand's force is above "
        f"{limits.force_trip:g} N"
    )
    (x0, y0, z0), (x1, y1, z1) = bounding_box(geometry)
    rows = [
        (f"joint {name}", f"{low:g} to {high:g} {unit}") for name, unit, low, high in geometry.joint_limits()
    ]
    rows += [
        ("box around it", f"x {x0:.3f} to {x1:.3f} m, y {y0:.3f} to {y1:.3f} m, z {z0:g} to {z1:g} m"),
        ("speed", f"{options.motion.speed:g} m/s unless said, {options.motion.speed_max:g} m/s at most"),
        ("acceleration", f"{options.motion.acceleration:g} m/s^2"),
        ("joint speeds", speeds),
        ("force", forces),
        ("heartbeat", f"{options.watch.heartbeat_s:g} s"),
    ]
    context.console.write_rows(rows)


def send(context: Context, text: str) -> None:
    """Send a line of the device's own language and show the answer; raises as `Drive.command`."""
    drive = context.drive
    reply = drive.command(text)
    context.console.write(reply)
    words = text.split()
    if words[:2] == ["set", "state"] and words[2:3] not in (["stop"], ["off"]):
        context.console.tell("no loop watches the arm now: none of our limits holds")
