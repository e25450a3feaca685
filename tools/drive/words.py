"""The words of the prompt and of the command line, and what each does."""

import math
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from hm_driver.errors import ConfigurationError, HapticMasterError
from hm_driver.geometry import ArmGeometry
from hm_driver.protocol.commands import VERBS
from hm_driver.protocol.vocabulary import State
from hm_driver.realtime.modes import PositionControl
from tools.drive import language
from tools.drive.effect_words import effect_word
from tools.drive.language import Argument, Call, Option, Word
from tools.drive.log import free_log
from tools.drive.options import DriveOptions
from tools.drive.outcome import Arrival
from tools.drive.path_file import load_path
from tools.drive.pilot import ALL_AXES
from tools.drive.session import axis_index
from tools.drive.status import AXES, DriveStatus
from tools.drive.surface import Context

CONTROLS = {"spring": PositionControl.SPRING, "bias": PositionControl.BIAS_FORCE}
_STATES = ("stop", "force", "position", "init", "home", "off")
_PASSIVE = ("help", "quit", "exit")
"""Words that need no device."""


def build_words(options: DriveOptions) -> Mapping[str, Word[Context]]:
    """The language, with the ranges of a configuration."""
    words = [*_motion_words(options), *_mode_words(), *_device_words(), *_other_words()]
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
        _send(context, " ".join(line))
        return None
    word = language.find(context.words, line[0])
    word.run(context, language.read(word, line[1:]))
    return word


def _number(name: str, doc: str, unit: str, low: float, high: float, *, refused: bool = True) -> Argument:
    return Argument(
        name=name, doc=doc, is_number=True, unit=unit, low=low, high=high, is_range_checked=refused
    )


_SECONDS = Option(
    name="--seconds",
    doc="go on after this time; on the command line it ends with Ctrl-C without it",
    value=_number("S", "time", "s", 0.0, 86400.0),
)
_AXES = Argument(name="AXIS", doc="only these axes", choices=tuple(AXES), is_optional=True, is_repeated=True)


def _motion_words(options: DriveOptions) -> Iterable[Word[Context]]:
    motion = options.motion
    low, high = _box(ArmGeometry())
    speed = Option(
        name="--speed",
        doc=f"largest speed, {motion.speed:g} m/s unless said",
        value=_number("V", "speed", "m/s", 0.001, motion.speed_max),
    )
    yield Word(
        name="jog",
        doc="Move along one axis by a distance, from where the arm is held.",
        run=_jog,
        arguments=(
            Argument(name="AXIS", doc="axis", choices=tuple(AXES)),
            _number("DISTANCE", "how far", "m", -1.0, 1.0),
        ),
        options=(speed,),
        more="x points towards the user, y to the right, z up. Ctrl-C brakes on the way and holds.",
    )
    yield Word(
        name="goto",
        doc="Move to a point in a straight line.",
        run=_goto,
        arguments=tuple(
            _number(axis.upper(), f"{axis} of the point", "m", low[i], high[i], refused=False)
            for i, axis in enumerate(AXES)
        ),
        options=(speed,),
        more="A point, or a way, outside the workspace is refused; 'limits' shows it.",
    )
    yield Word(
        name="run",
        doc="Run a trajectory from a CSV file with the columns time_s,x,y,z and, if wanted, vx,vy,vz.",
        run=_run_file,
        arguments=(Argument(name="FILE", doc="the CSV file; s, m, m/s", is_path=True),),
        options=(
            Option(name="--speed", doc="largest speed of the way to its start", value=speed.value),
            Option(
                name="--within",
                doc="fail (exit code 1) where the arm is farther from the trajectory than this",
                value=_number("M", "distance", "m", 1e-5, 1.0),
            ),
            Option(name="--check", doc="check the file and move nothing"),
            Option(name="--json", doc="the summary as one JSON object"),
        ),
        more="The whole file is checked before anything moves: header, times, reach, speed.",
    )


def _mode_words() -> Iterable[Word[Context]]:
    yield Word(
        name="hold",
        doc="Hold the arm, or some axes, where they are (position mode).",
        run=lambda context, call: _after(context, call, lambda: context.drive.hold(_indices(call.rest))),
        arguments=(_AXES,),
        options=(_SECONDS,),
        stays=True,
    )
    yield Word(
        name="release",
        doc="Let the hand move the arm, or some axes (admittance mode).",
        run=lambda context, call: _after(context, call, lambda: context.drive.release(_indices(call.rest))),
        arguments=(_AXES,),
        options=(_SECONDS,),
        stays=True,
    )
    yield Word(
        name="mode",
        doc="As hold and release, by the mode's name.",
        run=_mode,
        arguments=(Argument(name="MODE", doc="mode", choices=("admittance", "position")), _AXES),
        options=(_SECONDS,),
        stays=True,
    )
    yield Word(
        name="inertia",
        doc="Show or set the virtual mass that the hand moves.",
        run=_inertia,
        arguments=(
            Argument(
                name="MASS", doc="mass", is_number=True, unit="kg", low=2.0, high=20.0, is_optional=True
            ),
        ),
        more="A loop that runs starts anew with it; the arm stands still meanwhile, for about a second.",
    )
    yield Word(
        name="control",
        doc="Show or choose what position mode pulls with.",
        run=_control,
        arguments=(
            Argument(
                name="WAY",
                doc="spring on the device, or bias force by the loop",
                choices=tuple(CONTROLS),
                is_optional=True,
            ),
        ),
        more="spring: moving virtual springs of the device. bias: a PD law of the loop, sent as bias force.",
    )


def _device_words() -> Iterable[Word[Context]]:
    yield Word(
        name="state",
        doc="Show the state live until Ctrl-C, or put the device into another one.",
        run=_state,
        arguments=(Argument(name="STATE", doc="state", choices=_STATES, is_optional=True),),
        options=(
            Option(name="--once", doc="one look"),
            Option(name="--json", doc="JSON, an object a line"),
            _SECONDS,
            Option(name="--rate", doc="looks in a second", value=_number("HZ", "rate", "Hz", 0.1, 100.0)),
        ),
        more=(
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
            _SECONDS,
        ),
        more="On the command line the arm is held meanwhile, unless another command stands before it.",
        stays=True,
    )  # fmt: skip
    yield Word(name="limits", doc="Show the workspace and the limits that hold.", run=_limits)
    yield Word(
        name="raw",
        doc="Send a line of the device's own language; those verbs work without 'raw' too.",
        run=lambda context, call: _send(context, " ".join(call.rest)),
        arguments=(Argument(name="COMMAND", doc=f"begins with {', '.join(VERBS)}", is_repeated=True),),
        more="As in: get measpos; set state force; create spring s1; set s1 stiffness 200",
    )


def _other_words() -> Iterable[Word[Context]]:
    yield Word(
        name="wait",
        doc="Wait, for scripts; the arm stays as it is.",
        run=lambda context, call: _wait(context, call.number("S")),
        arguments=(_number("S", "time", "s", 0.0, 86400.0),),
    )
    yield Word(
        name="help",
        doc="Explain a word, or list them all.",
        run=_help,
        arguments=(Argument(name="WORD", doc="the word", is_optional=True),),
    )
    for name in ("quit", "exit"):
        yield Word(name=name, doc="End, with the arm stopped (as Ctrl-D).", run=_quit)


def _jog(context: Context, call: Call) -> None:
    drive, axis = context.drive, axis_index(call.text("AXIS"))
    x, y, z = (
        place + (call.number("DISTANCE") if i == axis else 0.0) for i, place in enumerate(drive.place())
    )
    _show_arrival(context, drive.go("jog", (x, y, z), speed=_speed(call), axes=(axis,)))


def _goto(context: Context, call: Call) -> None:
    drive = context.drive
    goal = (call.number("X"), call.number("Y"), call.number("Z"))
    _show_arrival(context, drive.go("goto", goal, speed=_speed(call)))


def _run_file(context: Context, call: Call) -> None:
    drive = context.drive
    path = Path(call.text("FILE")).expanduser()
    trajectory = load_path(path, drive.geometry, drive.options.limits, drive.options.motion)
    what = f"{path}: {len(trajectory.times_s)} points, {trajectory.duration_s:.2f} s"
    if call.has("--check"):
        context.console.write(f"{what}; the arm can follow it")
        return
    context.console.tell(f"{what}; going to its start")
    drive.go("run", trajectory.positions[0], speed=_speed(call))
    arrival = drive.follow(trajectory)
    tracking = arrival.tracking
    if call.has("--json"):
        context.console.write_json(
            {
                "file": str(path),
                "points": len(trajectory.times_s),
                "duration_s": trajectory.duration_s,
                "samples": tracking.samples,
                "error_rms_m": tracking.rms_m,
                "error_max_m": tracking.max_m,
                "error_max_at_s": tracking.max_at_s,
                "error_end_m": arrival.error_m,
            }
        )
    else:
        context.console.write(
            f"done; error rms {1e3 * tracking.rms_m:.2f} mm, max {1e3 * tracking.max_m:.2f} mm at "
            f"{tracking.max_at_s:.2f} s, {1e3 * arrival.error_m:.2f} mm at the end"
        )
    allowed = call.number("--within", math.inf)
    if tracking.max_m > allowed:
        raise HapticMasterError(
            f"run --within: the arm was {1e3 * tracking.max_m:.2f} mm off after {tracking.max_at_s:.2f} s; "
            f"allowed were {1e3 * allowed:g} mm. Slow the trajectory down, or allow more"
        )


def _speed(call: Call) -> float | None:
    return call.number("--speed") if call.has("--speed") else None


def _show_arrival(context: Context, arrival: Arrival) -> None:
    context.console.write(
        "at [{:.4f}, {:.4f}, {:.4f}] m".format(*arrival.position)
        + f", {1e3 * arrival.error_m:.2f} mm from the goal; took {arrival.duration_s:.2f} s, "
        f"largest error on the way {1e3 * arrival.tracking.max_m:.2f} mm"
    )


def _mode(context: Context, call: Call) -> None:
    drive = context.drive
    act = drive.release if call.text("MODE") == "admittance" else drive.hold
    _after(context, call, lambda: act(_indices(call.rest)))


def _after(context: Context, call: Call, act: Callable[[], None]) -> None:
    act()
    _say_mode(context)
    if call.has("--seconds"):
        _wait(context, call.number("--seconds"))


def _say_mode(context: Context) -> None:
    pilot = context.drive.pilot
    if pilot is None:
        return
    held = [axis for axis, engaged in zip(AXES, pilot.engaged, strict=True) if engaged]
    free = [axis for axis in AXES if axis not in held]
    parts = [f"{' '.join(held)} held"] if held else []
    parts += [f"{' '.join(free)} free"] if free else []
    context.console.write(", ".join(parts))


def _inertia(context: Context, call: Call) -> None:
    drive = context.drive
    if call.has("MASS"):
        drive.set_inertia(call.number("MASS"))
    elif not drive.is_driving:
        context.console.write(
            f"{drive.arm.inertia:g} kg on the device; the loop sets {drive.options.modes.inertia:g} kg"
        )
        return
    context.console.write(f"inertia {drive.options.modes.inertia:g} kg")


def _control(context: Context, call: Call) -> None:
    drive = context.drive
    if call.has("WAY"):
        drive.set_control(CONTROLS[call.text("WAY")])
    now = drive.options.modes.position_control
    context.console.write(next(name for name, control in CONTROLS.items() if control is now))


def _state(context: Context, call: Call) -> None:
    drive, console = context.drive, context.console
    if call.has("STATE"):
        state = State(call.text("STATE"))
        if state in (State.INIT, State.HOME):
            console.tell("the arm moves by itself, and no loop of ours watches it: keep your hands off")
        drive.enter(state)
        console.write(f"state {drive.arm.state.value}")
        if state in (State.FORCE, State.POSITION):
            _say_mode(context)
        return
    if call.has("--once"):
        status = drive.status()
        if drive.is_driving and not status.rate_hz:  # a rate needs two looks
            time.sleep(0.12)
            status = drive.status()
        if call.has("--json"):
            console.write_json(status.as_dict())
        else:
            console.write_rows(status.rows())
        return
    _watch(
        context,
        call.number("--seconds", math.inf),
        as_json=call.has("--json"),
        rate_hz=call.number("--rate", 0.0),
    )


def _watch(context: Context, seconds: float, *, as_json: bool = False, rate_hz: float = 0.0) -> None:
    """Show the state; in the prompt Ctrl-C ends the showing alone."""
    drive = context.drive

    def look() -> DriveStatus:
        failure = drive.take_failure()
        if failure is not None:
            raise failure
        return drive.status()

    try:
        context.console.watch(look, seconds=seconds, as_json=as_json, rate_hz=rate_hz)
    except KeyboardInterrupt as stop:
        if context.is_one_shot or type(stop) is not KeyboardInterrupt:
            raise


def stay(context: Context) -> None:
    """Leave what was brought about as it is, showing the state, until Ctrl-C or the loop's end."""
    drive = context.drive
    if not drive.is_driving:
        drive.ensure_loop()
        drive.release()
    context.console.tell("until Ctrl-C:")
    _watch(context, math.inf)


def _wait(context: Context, seconds: float) -> None:
    drive = context.drive
    ends = time.monotonic() + seconds
    while (remaining := ends - time.monotonic()) > 0.0:
        failure = drive.take_failure()
        if failure is not None:
            raise failure
        context.console.draw(lambda: drive.status().line())
        time.sleep(min(0.05, remaining))
    context.console.clear()


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
        _wait(context, call.number("--seconds"))
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
    (x0, y0, z0), (x1, y1, z1) = _box(geometry)
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


def _send(context: Context, text: str) -> None:
    drive = context.drive
    reply = drive.command(text)
    context.console.write(reply)
    words = text.split()
    if words[:2] == ["set", "state"] and words[2:3] not in (["stop"], ["off"]):
        context.console.tell("no loop watches the arm now: none of our limits holds")


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


def _indices(axes: tuple[str, ...]) -> tuple[int, ...]:
    return tuple(axis_index(axis) for axis in axes) or ALL_AXES


def _box(geometry: ArmGeometry) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Lowest and highest coordinates of the workspace [m]."""
    inner, outer = geometry.r0 + geometry.r_min, geometry.r0 + geometry.r_max
    widest = max(abs(geometry.phi_min), abs(geometry.phi_max))
    return (
        (inner * math.cos(widest) - geometry.r0, outer * math.sin(geometry.phi_min), geometry.z_min),
        (geometry.r_max, outer * math.sin(geometry.phi_max), geometry.z_max),
    )
