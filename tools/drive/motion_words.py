"""The words that move the arm: ``jog``, ``goto`` and ``run``."""

import math
from collections.abc import Iterable
from pathlib import Path

from hm_driver.errors import HapticMasterError
from hm_driver.geometry import ArmGeometry
from tools.drive.language import Argument, Call, Option, Word, number
from tools.drive.options import DriveOptions
from tools.drive.outcome import Arrival
from tools.drive.path_file import load_path
from tools.drive.reach import bounding_box
from tools.drive.session import axis_index
from tools.drive.status import AXES
from tools.drive.surface import Context


def motion_words(options: DriveOptions) -> Iterable[Word[Context]]:
    """The words, with the ranges of a configuration."""
    motion = options.motion
    low, high = bounding_box(ArmGeometry())
    speed = Option(
        name="--speed",
        doc=f"largest speed, {motion.speed:g} m/s unless said",
        value=number("V", "speed", "m/s", 0.001, motion.speed_max),
    )
    yield Word(
        name="jog",
        doc="Move along one axis by a distance, from where the arm is held.",
        run=_jog,
        arguments=(
            Argument(name="AXIS", doc="axis", choices=tuple(AXES)),
            number("DISTANCE", "how far", "m", -1.0, 1.0),
        ),
        options=(speed,),
        more="x points towards the user, y to the right, z up. Ctrl-C brakes on the way and holds.",
    )
    yield Word(
        name="goto",
        doc="Move to a point in a straight line.",
        run=_goto,
        arguments=tuple(
            number(axis.upper(), f"{axis} of the point", "m", low[i], high[i], refused=False)
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
                value=number("M", "distance", "m", 1e-5, 1.0),
            ),
            Option(name="--check", doc="check the file and move nothing"),
            Option(name="--json", doc="the summary as one JSON object"),
        ),
        more="The whole file is checked before anything moves: header, times, reach, speed.",
    )


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
