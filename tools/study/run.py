"""Runs a study file into a directory, and goes on where an earlier run was stopped."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tools.study.execute import BATCH, Backend, Lost, execute
from tools.study.plan import SessionJob, Study
from tools.study.row import Row, run_session
from tools.study.store import Store

Notify = Callable[[int, int], None]
"""Takes how many sessions are done, and how many there are."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of a run."""

    sessions: int
    """Sessions of the study."""
    were_there: int
    """Of them done before."""
    ran: int
    """Of them done now."""
    ended_early: int
    """Of these, how many an error or a trip ended."""
    lost: tuple[Lost, ...]
    """Sessions without a result: their workers died."""


def run_study(
    study: Study,
    directory: Path,
    *,
    workers: int,
    backend: Backend = Backend.LOKY,
    address: str | None = None,
    batch: int = BATCH,
    notify: Notify = lambda _done, _all: None,
    run: Callable[[SessionJob], Row] = run_session,
) -> Outcome:
    """Run the sessions that a directory does not have yet.

    Args:
        study: What to run.
        directory: Of the results.
        workers: Processes on this machine.
        backend: Where the sessions run.
        address: Of a cluster.
        batch: Sessions of a batch.
        notify: Told of the progress.
        run: What runs one session.

    Raises:
        ConfigurationError: The directory holds something else, or the backend is not there.
    """
    store = Store(directory)
    store.begin(study)
    jobs = study.jobs
    there = store.keys()
    missing = [job for job in jobs if job.key not in there]
    done, ended_early, lost = len(jobs) - len(missing), 0, list[Lost]()
    were_there = done
    notify(done, len(jobs))
    if missing:
        for progress in execute(
            missing, workers=workers, backend=backend, address=address, batch=batch, run=run
        ):
            if progress.rows:
                store.add(progress.rows)
            if progress.lost is not None:
                lost.append(progress.lost)
            done += len(progress.rows)
            ended_early += sum(bool(row["ended"]) for row in progress.rows)
            notify(done, len(jobs))
    return Outcome(
        sessions=len(jobs),
        were_there=were_there,
        ran=done - were_there,
        ended_early=ended_early,
        lost=tuple(lost),
    )
