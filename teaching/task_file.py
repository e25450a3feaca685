"""Tasks as TOML files: another surface needs no code.

Example:
    >>> from teaching.task_file import load_task
    >>> task = load_task("paper")
    >>> task.stiffness(-0.1, -0.1)
    100.0
"""

import json
import math
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from hm_driver.errors import ConfigurationError
from teaching.stiffness_array import Interpolation, StiffnessArray, read_array
from teaching.surface import Point, SurfaceObject, rotated
from teaching.task import Task

CIRCLE_CORNERS = 72
"""Corners of the polygon that a circle becomes: 0.1 % of its radius off."""


def load_task(path_or_name: str | Path) -> Task:
    """Read a task from a TOML file, or one that comes with the package by its name.

    Raises:
        ConfigurationError: There is no such task, or a field of it is wrong.
    """
    given = str(path_or_name)
    if Path(given).suffix != ".toml" and Path(given).name == given:
        names = task_names()
        if given not in names:
            raise ConfigurationError(
                "task", f"{given!r} is neither a .toml file nor one of {', '.join(names)}"
            )
        folder = resources.files("teaching") / "tasks"
        text = (folder / f"{given}.toml").read_text(encoding="utf-8")
        with resources.as_file(folder) as directory:
            return parse_task(text, source=f"{given}.toml", directory=directory)
    try:
        text = Path(given).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        shipped = ", ".join(task_names())
        raise ConfigurationError(
            "task", f"cannot be read: {error}; tasks that come with the package: {shipped}", source=given
        ) from error
    return parse_task(text, source=given, directory=Path(given).parent)


def task_names() -> list[str]:
    """Names of the tasks that come with the package."""
    folder = resources.files("teaching") / "tasks"
    return sorted(Path(entry.name).stem for entry in folder.iterdir() if entry.name.endswith(".toml"))


def parse_task(text: str, *, source: str = "", directory: Path | None = None) -> Task:
    """Read a task from TOML.

    Args:
        text: The file's text.
        source: The file's name, for errors.
        directory: Where the file of an array is looked for; default: the working directory.

    Raises:
        ConfigurationError: It is no TOML, or a field is wrong.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError("task", f"is no TOML: {error}", source=source) from error
    return task_from_dict(data, source=source, directory=directory)


def task_from_dict(data: dict[str, Any], *, source: str = "", directory: Path | None = None) -> Task:
    """Make a task of the tables of its file; arguments as for :func:`parse_task`.

    Raises:
        ConfigurationError: A field is missing, misspelt, of the wrong type or out of range.
    """
    top = _Table(data, "", source)
    name, description = top.text("name"), top.text("description", "")
    plane = top.table("plane")
    size, height = plane.number("size", 0.4), plane.number("surface_z", 0.0)
    angle = math.radians(plane.number("rotation_deg", 0.0))
    plane.finish()
    reference = top.table("reference")
    force = reference.number("force", 10.0)
    reference.finish()
    mapping = top.table("mapping")
    scale, offset = (
        mapping.numbers("scale", 3, [1.3, 1.3, 1.0]),
        mapping.numbers("offset", 3, [0.005, 0.0, 0.06]),
    )
    mapping.finish()
    array = _array(top, size, angle, directory) if top.has("array") else None
    has_objects = array is None or top.has("objects")
    objects = tuple(_object(table, angle) for table in top.tables("objects")) if has_objects else ()
    top.finish()
    try:
        return Task(
            array=array,
            name=name,
            description=description,
            objects=objects,
            size=size,
            surface_z=height,
            reference_force=force,
            scale=(scale[0], scale[1], scale[2]),
            offset=(offset[0], offset[1], offset[2]),
        )
    except ConfigurationError as error:
        raise ConfigurationError(error.field, error.problem, source=source) from error


def format_task(task: Task) -> str:
    """The task as TOML, complete with its defaults."""
    data = task.to_dict()
    lines = [f"{key} = {_toml(data[key])}" for key in ("name", "description")]
    for section in ("plane", "reference", "mapping"):
        lines += ["", f"[{section}]", *(f"{key} = {_toml(value)}" for key, value in data[section].items())]
    if "array" in data:
        lines += ["", "[array]", *(f"{key} = {_toml(value)}" for key, value in data["array"].items())]
    for thing in data.get("objects", []):
        lines += ["", "[[objects]]", *(f"{key} = {_toml(value)}" for key, value in thing.items())]
    return "\n".join(lines) + "\n"


def _toml(value: object) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return json.dumps(value) if isinstance(value, str) else repr(value)


def _object(table: "_Table", angle: float) -> SurfaceObject:
    outline = _outline(table)
    gradient = table.numbers("gradient", 2, [0.0, 0.0])
    name, colour, stiffness = table.text("name"), table.text("colour"), table.number("stiffness")
    table.finish()
    turned = rotated(((gradient[0], gradient[1]),), angle)[0]
    try:
        return SurfaceObject(
            name=name,
            outline=rotated(outline, angle),
            stiffness=stiffness,
            gradient=turned,
            colour=colour,
        )
    except ConfigurationError as error:
        raise ConfigurationError(table.path(error.field), error.problem, source=table.source) from error


def _array(top: "_Table", size: float, angle: float, directory: Path | None) -> StiffnessArray:
    table = top.table("array")
    if angle != 0.0:
        raise top.error("plane.rotation_deg", "an array cannot be turned; turn its numbers")
    if table.has("file") == table.has("values"):
        raise table.error("file", "give either the name of a .npy or .csv file, or values, not both")
    half = 0.5 * size
    extent = table.numbers("extent", 4, [-half, half, -half, half])
    border, interpolation = table.number("border", 0.2), table.text("interpolation", "nearest")
    if interpolation not in {kind.value for kind in Interpolation}:
        kinds = ", ".join(kind.value for kind in Interpolation)
        raise table.error("interpolation", f"{interpolation!r} must be one of {kinds}")
    try:
        if table.has("file"):
            values = read_array((directory or Path()) / table.text("file"))
        else:
            values = table.rows("values")
        made = StiffnessArray(
            values=values,
            extent=(extent[0], extent[1], extent[2], extent[3]),
            interpolation=Interpolation(interpolation),
            border=border,
        )
    except ConfigurationError as error:
        raise ConfigurationError(error.field, error.problem, source=top.source) from error
    table.finish()
    return made


def _outline(table: "_Table") -> tuple[Point, ...]:
    if [table.has(key) for key in ("rectangle", "polygon", "circle")].count(True) != 1:
        raise table.error(
            "rectangle",
            "give one of rectangle = [x_min, y_min, x_max, y_max], polygon = [[x, y], ...] and "
            "circle = [x, y, radius]",
        )
    if table.has("circle"):
        x, y, radius = table.numbers("circle", 3)
        if not radius > 0.0:
            raise table.error("circle", f"radius {radius:g} m must be above 0")
        turns = [2.0 * math.pi * k / CIRCLE_CORNERS for k in range(CIRCLE_CORNERS)]
        return tuple((x + radius * math.cos(turn), y + radius * math.sin(turn)) for turn in turns)
    if table.has("rectangle"):
        x_min, y_min, x_max, y_max = table.numbers("rectangle", 4)
        if not (x_min < x_max and y_min < y_max):
            raise table.error(
                "rectangle", f"[{x_min}, {y_min}, {x_max}, {y_max}] must be x_min, y_min, x_max, y_max"
            )
        return (x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)
    return table.points("polygon")


class _Table:
    """A table of the file that knows where it stands and which of its keys were read."""

    def __init__(self, data: dict[str, Any], prefix: str, source: str) -> None:
        self._data, self._prefix, self.source = data, prefix, source
        self._known: list[str] = []

    def path(self, key: str) -> str:
        return f"{self._prefix}{key}"

    def error(self, key: str, problem: str) -> ConfigurationError:
        return ConfigurationError(self.path(key), problem, source=self.source)

    def has(self, key: str) -> bool:
        self._known.append(key)
        return key in self._data

    def text(self, key: str, default: str | None = None) -> str:
        value = self._get(key, default)
        if not isinstance(value, str):
            raise self.error(key, f"{value!r} must be text")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        return self._number(key, self._get(key, default))

    def numbers(self, key: str, count: int, default: list[float] | None = None) -> list[float]:
        value = self._get(key, default)
        if not isinstance(value, list) or len(value) != count:
            raise self.error(key, f"{value!r} must be a list of {count} numbers")
        return [self._number(key, item) for item in value]

    def points(self, key: str) -> tuple[Point, ...]:
        value = self._get(key, None)
        if not isinstance(value, list) or not all(isinstance(p, list) and len(p) == 2 for p in value):
            raise self.error(key, f"{value!r} must be a list of [x, y]")
        return tuple((self._number(key, x), self._number(key, y)) for x, y in value)

    def rows(self, key: str) -> tuple[tuple[float, ...], ...]:
        value = self._get(key, None)
        if not isinstance(value, list) or not all(isinstance(row, list) for row in value):
            raise self.error(key, "must be a list of lists of numbers")
        return tuple(tuple(self._number(key, item) for item in row) for row in value)

    def table(self, key: str) -> "_Table":
        value = self._get(key, {})
        if not isinstance(value, dict):
            raise self.error(key, f"{value!r} must be a table, [{key}]")
        return _Table(value, f"{self._prefix}{key}.", self.source)

    def tables(self, key: str) -> list["_Table"]:
        value = self._get(key, None)
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self.error(key, f"must be a list of tables, [[{key}]]")
        return [_Table(item, f"{self._prefix}{key}[{i}].", self.source) for i, item in enumerate(value)]

    def finish(self) -> None:
        """Refuse keys that nobody asked for."""
        for key in self._data:
            if key not in self._known:
                raise self.error(key, f"is unknown; known here: {', '.join(dict.fromkeys(self._known))}")

    def _get(self, key: str, default: object) -> Any:  # noqa: ANN401 - a TOML value
        self._known.append(key)
        if key not in self._data and default is None:
            raise self.error(key, "is missing")
        return self._data.get(key, default)

    def _number(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise self.error(key, f"{value!r} must be a finite number")
        return float(value)
