"""What a study runs: its file, and the cases and sessions that this describes.

A study file is TOML::

    format = 1
    title = "Two methods on two surfaces"
    seed = 1                          # of the whole study
    repeats = 10                      # sessions of each case; session i of every case has the same seed

    [base]                            # over the defaults, in every session
    session.practice = 2.0

    [levels.demonstrator]             # names for sets of options, to be used like a value below
    expert = {}
    hasty = { demonstrator.speed = 0.3, demonstrator.lag = 0.25 }

    [cross]                           # every combination
    method = ["paper", "confident"]
    task = ["paper", "turned"]
    demonstrator = ["expert", "hasty"]

    [[sensitivity]]                   # one parameter at a time, from one combination
    at = { method = "confident", task = "paper", demonstrator = "expert" }
    vary = { "learner.w_gen" = [0.3, 0.5, 0.7] }

Keys are those of the configuration of ``hm teach`` (``hm config show``), or names of ``levels``.
"""

import hashlib
import itertools
import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from hm_driver.errors import ConfigurationError
from teaching.task import Task
from teaching.task_file import load_task
from tools.config_text import to_dict
from tools.config_types import suggestion
from tools.run.options import TeachOptions, load_options

FORMAT: Final = 1
"""Version of study files and of their results."""
MOST_REPEATS: Final = 10_000
MOST_SESSIONS: Final = 1_000_000
_KEYS: Final = ("format", "title", "seed", "repeats", "base", "levels", "cross", "sensitivity")
_BLOCK_KEYS: Final = ("at", "vary", "repeats")

Settings = tuple[tuple[str, str], ...]
"""Name and value of each axis, as they stand in the file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionJob:
    """One session to run."""

    key: str
    """Digest of everything that decides its course."""
    options: TeachOptions
    task: Task
    seed: int
    """As ``hm teach --fast --seed`` takes it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """Sessions that differ by their seed alone."""

    part: str
    """``cross``, or the parameter that is varied."""
    settings: Settings
    """What was chosen for this case."""
    jobs: tuple[SessionJob, ...]

    @property
    def name(self) -> str:
        """The settings in one line."""
        return " ".join(f"{axis}={value}" for axis, value in self.settings) or "base"


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A study file, read and checked."""

    path: Path
    title: str
    text: str
    """The file as it is."""
    cases: tuple[Case, ...]

    @property
    def jobs(self) -> tuple[SessionJob, ...]:
        """Every session once, in the order of the cases' repeats, so that all cases grow alike."""
        rounds = itertools.zip_longest(*(case.jobs for case in self.cases))
        return tuple({job.key: job for row in rounds for job in row if job is not None}.values())


def load_study(path: Path) -> Study:
    """Read a study file, and check every session that it describes.

    Raises:
        ConfigurationError: The file cannot be read, is of another version, or holds an unknown key, a wrong
            type or a value out of range; names the file and the key.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        tree = tomllib.loads(text)
    except OSError as error:
        raise ConfigurationError(
            "file", f"cannot be read: {error.strerror or error}", source=str(path)
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigurationError("file", "is not UTF-8 text", source=str(path)) from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError("file", f"is not valid TOML: {error}", source=str(path)) from error
    reader = _Reader(path, tree)
    title = reader.text("title", default=path.stem)
    return Study(path=path, title=title, text=text, cases=tuple(reader.cases()))


class _Reader:
    def __init__(self, path: Path, tree: Mapping[str, Any]) -> None:
        self._path, self._tree = path, tree
        self._check_keys(tree, _KEYS, "")
        self._check_format()
        self._seed = self._whole("seed", tree.get("seed", 1), 0, 2**63 - 1)
        self._repeats = self._whole("repeats", tree.get("repeats", 10), 1, MOST_REPEATS)
        self._base = dict(_flat(self._table("base")))
        self._levels: dict[str, dict[str, dict[str, Any]]] = {}
        for axis, table in self._table("levels").items():
            named = self._inner(f"levels.{axis}", table)
            self._levels[axis] = {
                name: dict(_flat(self._inner(f"levels.{axis}.{name}", options)))
                for name, options in named.items()
            }

    def cases(self) -> Iterator[Case]:
        """All cases; a session that belongs to two of them has one key."""
        cross = {axis: self._values(f"cross.{axis}", axis, value) for axis, value in self._axes("cross")}
        size = self._repeats
        for values in cross.values():
            size *= len(values)
        if size > MOST_SESSIONS:
            self._refuse("cross", f"describes {size} sessions; at most {MOST_SESSIONS}")
        for chosen in itertools.product(*cross.values()):
            yield self._case("cross", dict(zip(cross, chosen, strict=True)), self._repeats, "cross")
        blocks = self._tree.get("sensitivity", [])
        if not isinstance(blocks, list) or not all(isinstance(block, dict) for block in blocks):
            self._refuse("sensitivity", "must be tables headed [[sensitivity]]")
        first = {axis: values[0] for axis, values in cross.items()}
        for index, block in enumerate(blocks):
            yield from self._one_at_a_time(f"sensitivity[{index}]", block, first)

    def text(self, key: str, *, default: str) -> str:
        value = self._tree.get(key, default)
        if not isinstance(value, str):
            self._refuse(key, f"must be text, not {value!r}")
        return str(value)

    def _one_at_a_time(
        self, place: str, block: Mapping[str, Any], first: Mapping[str, Any]
    ) -> Iterator[Case]:
        self._check_keys(block, _BLOCK_KEYS, f"{place}.")
        repeats = self._whole(f"{place}.repeats", block.get("repeats", self._repeats), 1, MOST_REPEATS)
        at = dict(first)
        for axis, value in self._pairs(self._inner(f"{place}.at", block.get("at", {}))):
            at[axis] = self._values(f"{place}.at.{axis}", axis, [value])[0]
        vary = self._pairs(self._inner(f"{place}.vary", block.get("vary", {})))
        if not vary:
            self._refuse(f"{place}.vary", 'names no parameter; it takes { "learner.w_gen" = [0.5, 0.8] }')
        for axis, given in vary:
            for value in self._values(f"{place}.vary.{axis}", axis, given):
                yield self._case(axis, at | {axis: value}, repeats, f"{place}.vary.{axis}")

    def _case(self, part: str, settings: Mapping[str, Any], repeats: int, place: str) -> Case:
        overrides = dict(self._base)
        for axis, value in settings.items():
            overrides.update(self._levels[axis][value] if axis in self._levels else {axis: value})
        texts = {key: _as_toml(value, self._path.parent, key) for key, value in overrides.items()}
        try:
            options = load_options(overrides=texts).value
            task = _task(options.task)
            task.check_reach(options.geometry)
        except ConfigurationError as error:
            where = error.field if error.field in overrides else f"{place} ({error.field})"
            raise ConfigurationError(where, error.problem, source=str(self._path)) from error
        seeds = session_seeds(self._seed, repeats)
        jobs = tuple(
            SessionJob(key=digest(options, task, seed), options=options, task=task, seed=seed)
            for seed in seeds
        )
        chosen = tuple((axis, _shown(value)) for axis, value in settings.items())
        return Case(part=part, settings=chosen, jobs=jobs)

    def _axes(self, name: str) -> list[tuple[str, Any]]:
        return self._pairs(self._table(name))

    def _pairs(self, table: Mapping[str, Any]) -> list[tuple[str, Any]]:
        """Axes and values of a table, in which a key of the configuration may be written as tables."""
        rest = {
            axis: value
            for axis, value in table.items()
            if axis not in self._levels or isinstance(value, dict)
        }
        named = [(axis, value) for axis, value in table.items() if axis not in rest]
        order = list(table)
        return sorted([*named, *_flat(rest)], key=lambda pair: order.index(_head(pair[0], order)))

    def _values(self, place: str, axis: str, given: object) -> list[Any]:
        if not isinstance(given, list) or not given:
            self._refuse(place, f"must be an array of values, not {given!r}")
        values: list[Any] = list(given) if isinstance(given, list) else []
        if axis in self._levels:
            for value in values:
                if value not in self._levels[axis]:
                    known = ", ".join(self._levels[axis])
                    self._refuse(
                        place,
                        f"{value!r} is none of its levels, {known}{suggestion(value, self._levels[axis])}",
                    )
        for value, more in itertools.pairwise(sorted(map(repr, values))):
            if value == more:
                self._refuse(place, f"has {value} twice")
        return values

    def _check_format(self) -> None:
        version = self._tree.get("format")
        if version is None:
            self._refuse("format", f"is missing; a study file of this version begins with format = {FORMAT}")
        if version != FORMAT or isinstance(version, bool):
            self._refuse(
                "format",
                f"{version!r} is another version's; this one reads {FORMAT}: run the file with the version "
                "that wrote it, or bring it up to date by docs/study.md",
            )

    def _check_keys(self, table: Mapping[str, Any], known: Sequence[str], prefix: str) -> None:
        for key in table:
            if key not in known:
                hint = suggestion(key, known, prefix) or f"; known here: {', '.join(known)}"
                self._refuse(f"{prefix}{key}", f"no such key{hint}")

    def _table(self, name: str) -> Mapping[str, Any]:
        return self._inner(name, self._tree.get(name, {}))

    def _inner(self, place: str, value: object) -> Mapping[str, Any]:
        if not isinstance(value, dict):
            self._refuse(place, f"must be a table, not {value!r}")
        return value if isinstance(value, dict) else {}

    def _whole(self, key: str, value: object, low: int, high: int) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            self._refuse(key, f"{value!r} must be a whole number from {low} to {high}")
        return value if isinstance(value, int) else 0

    def _refuse(self, field: str, problem: str) -> None:
        raise ConfigurationError(field, problem, source=str(self._path))


def session_seeds(seed: int, repeats: int) -> list[int]:
    """Seeds of a study's sessions, each from a child of its own of the study's seed sequence.

    The first ones stay the same when there are more, and neither cases nor workers change them.
    """
    children = np.random.SeedSequence(seed).spawn(repeats)
    return [int(child.generate_state(1)[0]) for child in children]


def digest(options: TeachOptions, task: Task, seed: int) -> str:
    """Key of a session: the same for the same configuration, task and seed."""
    described = {"format": FORMAT, "options": to_dict(options), "task": task.to_dict(), "seed": seed}
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:20]


@cache
def _task(name: str) -> Task:
    return load_task(name)


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of nested tables."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _head(axis: str, order: Sequence[str]) -> str:
    return axis if axis in order else next(key for key in order if axis.startswith(f"{key}."))


def _as_toml(value: object, directory: Path, key: str) -> str:
    """A value as the command line would give it; a task's file is looked for beside the study file."""
    if isinstance(value, str):
        beside = directory / value
        return json.dumps(str(beside) if key == "task" and beside.is_file() else value)
    return json.dumps(value)


def _shown(value: object) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    return value if isinstance(value, str) else json.dumps(value)
