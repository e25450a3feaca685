"""A trajectory from a CSV file, checked line by line before anything moves.

The header names the columns: ``time_s,x,y,z`` in seconds and metres, and, if wanted, ``vx,vy,vz`` in metres a
second. Empty lines and lines that begin with ``#`` are left out.
"""

import bisect
import csv
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime.modes import LimitOptions
from tools.drive.options import MotionOptions
from tools.drive.reach import check_path, joint_peak
from tools.drive.trajectory import PathThrough, Vector

POSITION_COLUMNS = ("time_s", "x", "y", "z")
VELOCITY_COLUMNS = ("vx", "vy", "vz")
_MOST_ROWS = 50_000
_LONGEST_S = 3600.0
_REST = 0.02
"""Speed that counts as rest [m/s]."""


class Row(NamedTuple):
    """A line of the file."""

    line: int
    """Its number, from 1."""
    values: tuple[float, ...]
    """In the order of the columns."""


def load_path(path: Path, geometry: ArmGeometry, limits: LimitOptions, motion: MotionOptions) -> PathThrough:
    """Read and check a trajectory.

    Raises:
        ConfigurationError: The file cannot be read, or what is in it is no trajectory for this arm; names
            file and line, column, value, limit.
    """
    rows = read_rows(path)
    for earlier, later in itertools.pairwise(rows):
        if later.values[0] <= earlier.values[0]:
            raise _problem(
                path, later.line, "time_s",
                f"{later.values[0]:g} s is not after the {earlier.values[0]:g} s of line {earlier.line}; "
                "times must rise from line to line",
            )  # fmt: skip
    for row in rows:
        broken = geometry.violation(*_vector(row.values, 1))
        if broken:
            raise _problem(path, row.line, "x,y,z", f"outside the workspace: {broken}")
    trajectory = PathThrough(
        [row.values[0] for row in rows],
        [_vector(row.values, 1) for row in rows],
        [_vector(row.values, 4) for row in rows] if len(rows[0].values) > len(POSITION_COLUMNS) else None,
    )
    if trajectory.duration_s > _LONGEST_S:
        raise _problem(
            path, rows[-1].line, "time_s", f"{trajectory.duration_s:g} s is longer than {_LONGEST_S:g} s"
        )
    _check_between(path, rows, trajectory, geometry, limits, motion)
    return trajectory


def read_rows(path: Path) -> list[Row]:
    """The lines of a file as numbers.

    Raises:
        ConfigurationError: The file cannot be read, or a line is not what the header announces.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no text in UTF-8"
        raise ConfigurationError("FILE", f"cannot be read: {reason}", source=str(path)) from error
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise ConfigurationError(
            "FILE", f"is empty; its first line is {','.join(POSITION_COLUMNS)}", source=str(path)
        )
    width = _check_header(path, *lines[0])
    if len(lines) < 3:
        raise ConfigurationError("FILE", f"has {len(lines) - 1} points; two are the least", source=str(path))
    if len(lines) - 1 > _MOST_ROWS:
        raise ConfigurationError(
            "FILE", f"has {len(lines) - 1} points; {_MOST_ROWS} are the most", source=str(path)
        )
    return [Row(number, _numbers(path, number, line, width)) for number, line in lines[1:]]


def _check_header(path: Path, number: int, line: str) -> int:
    names = [name.strip() for name in _cells(line)]
    wanted = ",".join(POSITION_COLUMNS)
    if tuple(names) not in (POSITION_COLUMNS, POSITION_COLUMNS + VELOCITY_COLUMNS):
        raise _problem(
            path, number, "header",
            f"{line.strip()[:60]!r} must be {wanted} or {wanted},{','.join(VELOCITY_COLUMNS)} "
            "(s, m, m/s; a comma between columns, a point in numbers)",
        )  # fmt: skip
    return len(names)


def _numbers(path: Path, number: int, line: str, width: int) -> tuple[float, ...]:
    columns = POSITION_COLUMNS + VELOCITY_COLUMNS
    cells = _cells(line)
    if len(cells) != width:
        raise _problem(path, number, "columns", f"{len(cells)} values; the header names {width}")
    values = []
    for name, cell in zip(columns, cells, strict=False):
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise _problem(path, number, name, f"{cell.strip()[:24]!r} is no finite number")
        values.append(value)
    return tuple(values)


def _check_between(
    path: Path,
    rows: Sequence[Row],
    trajectory: PathThrough,
    geometry: ArmGeometry,
    limits: LimitOptions,
    motion: MotionOptions,
) -> None:
    """What the points alone do not tell: rest at both ends, and speed and reach on the way between them."""
    for row, velocity in ((rows[0], trajectory.velocities[0]), (rows[-1], trajectory.velocities[-1])):
        if math.hypot(*velocity) > _REST:
            raise _problem(
                path, row.line, "vx,vy,vz",
                f"{math.hypot(*velocity):.3g} m/s; it must begin and end at rest ({_REST:g} m/s at most)",
            )  # fmt: skip
    time_s = max(trajectory.sample_times(), key=lambda time_s: math.hypot(*trajectory.at(time_s).velocity))
    speed = math.hypot(*trajectory.at(time_s).velocity)
    factor = math.ceil(100.0 * speed / motion.speed_max) / 100.0
    if speed > motion.speed_max * (1.0 + 1e-6):
        raise _problem(
            path, _line_at(rows, trajectory, time_s), "speed",
            f"{speed:.3g} m/s from this line to the next; the limit is {motion.speed_max:g} m/s "
            f"(motion.speed_max); multiply the times by {factor:g}",
        )  # fmt: skip
    peak = joint_peak(trajectory, geometry, limits)
    if peak.share > 1.0:
        raise _problem(
            path, _line_at(rows, trajectory, peak.time_s), "speed",
            f"joint {peak.joint} would move at {abs(peak.value):.3g} {peak.unit} from this line to the next; "
            f"the limit is {peak.limit:.3g} {peak.unit}; multiply the times by "
            f"{math.ceil(100.0 * peak.share) / 100.0:g}",
        )  # fmt: skip
    try:
        check_path("x,y,z", trajectory, geometry)
    except ConfigurationError as error:
        raise ConfigurationError(error.field, error.problem, source=str(path)) from error


def _line_at(rows: Sequence[Row], trajectory: PathThrough, time_s: float) -> int:
    index = bisect.bisect_right(trajectory.times_s, time_s) - 1
    return rows[min(max(0, index), len(rows) - 2)].line


def _cells(line: str) -> list[str]:
    return next(csv.reader([line]))


def _vector(values: Sequence[float], first: int) -> Vector:
    return (values[first], values[first + 1], values[first + 2])


def _problem(path: Path, line: int, column: str, text: str) -> ConfigurationError:
    return ConfigurationError(column, text, source=f"{path}, line {line}")
