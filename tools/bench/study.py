"""How fast a study runs: ``python -m tools.bench.study``, about three minutes.

First the fused session beside ``hm teach --fast``, in turns, as times real time;
then sessions of a study on one worker and on several, in turns. The best turn of each is told, as a busy
machine only ever adds to it, and what a session takes undisturbed: the sum of each tick's shortest time.
"""

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from cyclopts import App

from teaching.session import Tick
from teaching.task_file import load_task
from tools.cli.console import tell, write
from tools.run.fused import NoView, run_fused
from tools.run.lockstep import run_lockstep
from tools.run.options import TICK_S, load_options
from tools.run.request import TeachRequest
from tools.study.execute import execute
from tools.study.plan import SessionJob, digest, session_seeds
from tools.study.row import Trail, run_session

METHODS: Final = ("paper", "confident")
STUDY_SESSIONS: Final = 1000


class Speeds(NamedTuple):
    """One method, the best of all turns."""

    session_s: float
    """Virtual time of the session [s]."""
    fused_s: float
    """Wall time of the fused session [s]."""
    row_s: float
    """The same with the figures of a study [s]."""
    fast_s: float
    """Wall time as ``hm teach --fast``, without the report [s]."""
    tick_us: float
    """Mean wall time of a fused tick, each tick's shortest of all turns: what it takes undisturbed [us]."""


class Scaling(NamedTuple):
    """Sessions of a study on more than one worker."""

    sessions: int
    session_s: float
    """Virtual time of all of them [s]."""
    wall_s: dict[int, float]
    """Wall time of the best turn by the number of workers [s]."""


class TimedTrail(Trail):
    """A trail that notes when each tick was logged."""

    def __init__(self) -> None:
        super().__init__()
        self.times_ns: list[int] = []

    def tick(self, time_ns: int, tick: Tick) -> None:
        """Note a tick."""
        super().tick(time_ns, tick)
        self.times_ns.append(time.perf_counter_ns())


def measure_speeds(method: str, *, rounds: int, overrides: dict[str, str] | None = None) -> Speeds:
    """Run one session in every way, in turns."""
    options = load_options(overrides={"method": method} | (overrides or {})).value
    task = load_task(options.task)
    seed = session_seeds(1, 1)[0]
    job = SessionJob(key=digest(options, task, seed), options=options, task=task, seed=seed)
    best = dict.fromkeys(("fused", "row", "fast"), float("inf"))
    session_s = 0.0
    with tempfile.TemporaryDirectory() as directory:
        request = TeachRequest(options=options, task=task, seed=seed, output=Path(directory))
        trail = Trail()
        run_fused(request, trail)  # compiles, or loads what is stored
        session_s = TICK_S * (len(trail.trace().time_s) - 1)

        def fast() -> None:
            log = run_lockstep(request, NoView(), name="fast").log
            log.unlink()

        ticks_ns = np.full(round(session_s / TICK_S), np.inf)

        def fused() -> None:
            timed = TimedTrail()
            run_fused(request, timed)
            np.minimum(ticks_ns, np.diff(timed.times_ns), out=ticks_ns)

        ways: dict[str, Callable[[], object]] = {
            "fused": fused,
            "row": lambda: run_session(job),
            "fast": fast,
        }
        for _ in range(rounds):
            for name, way in ways.items():
                best[name] = min(best[name], _wall_s(way))
    return Speeds(session_s, best["fused"], best["row"], best["fast"], 1e-3 * float(ticks_ns.mean()))


def measure_scaling(methods: Sequence[str], workers: Sequence[int], *, sessions: int, rounds: int) -> Scaling:
    """Run the same sessions on one worker and on more, in turns."""
    jobs = []
    for seed in session_seeds(1, sessions // max(1, len(methods))):
        for method in methods:
            options = load_options(overrides={"method": method}).value
            task = load_task(options.task)
            jobs.append(SessionJob(key=digest(options, task, seed), options=options, task=task, seed=seed))
    best = dict.fromkeys(workers, float("inf"))
    total_s = 0.0
    for turn in range(rounds + 1):
        for number in workers:
            began = time.perf_counter()
            rows = [row for progress in execute(jobs, workers=number, batch=2) for row in progress.rows]
            if turn:  # the first one starts the workers and loads the kernels
                best[number] = min(best[number], time.perf_counter() - began)
            total_s = sum(float(row["session_s"]) for row in rows)
    return Scaling(len(jobs), total_s, best)


def _wall_s(way: Callable[[], object]) -> float:
    began = time.perf_counter()
    way()
    return time.perf_counter() - began


app = App(name="study", help="Measure how fast a study runs.")


@app.default
def main(*, rounds: int = 5, sessions: int = 24, workers: int = 2) -> None:
    """Measure and print.

    Args:
        rounds: How often the ways take turns.
        sessions: Sessions of a turn on the workers.
        workers: How many workers are compared with one.
    """
    tell("fused sessions beside hm teach --fast")
    heading = ("method", "session", "fused", "with figures", "--fast", "ratio", "undisturbed", "us a tick")
    write("".join(f"{cell:>14}" for cell in heading))
    for method in METHODS:
        speeds = measure_speeds(method, rounds=rounds)
        cells = (
            method,
            f"{speeds.session_s:.0f} s",
            f"{speeds.session_s / speeds.fused_s:.0f}x",
            f"{speeds.session_s / speeds.row_s:.0f}x",
            f"{speeds.session_s / speeds.fast_s:.0f}x",
            f"{speeds.fast_s / speeds.fused_s:.1f}",
            f"{1e6 * TICK_S / speeds.tick_us:.0f}x",
            f"{speeds.tick_us:.1f}",
        )
        write("".join(f"{cell:>14}" for cell in cells))
    tell(f"{sessions} sessions on 1 and on {workers} workers")
    scaling = measure_scaling(METHODS, (1, workers), sessions=sessions, rounds=max(1, rounds // 2))
    for number, wall_s in scaling.wall_s.items():
        minutes = wall_s / scaling.sessions * STUDY_SESSIONS / 60.0
        write(
            f"{number} worker{'s' * (number > 1)}: {scaling.session_s / wall_s:.0f}x real time, "
            f"{60.0 * scaling.sessions / wall_s:.0f} sessions a minute, "
            f"{STUDY_SESSIONS} sessions in {minutes:.1f} min"
        )
    write(f"{workers} workers: {scaling.wall_s[1] / scaling.wall_s[workers]:.2f} times one")


if __name__ == "__main__":
    app()
