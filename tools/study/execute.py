"""Runs a study's sessions in batches, on the cores of this machine or on a cluster."""

import contextlib
import importlib.util
import itertools
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from enum import Enum
from typing import Any, Final, NamedTuple

from hm_driver.errors import ConfigurationError
from tools.study.plan import SessionJob
from tools.study.row import Row, run_session

BATCH: Final = 4
"""Sessions of a batch: with a session a second, far more than what sending a batch costs."""
CONNECT_S: Final = 10.0
"""How long a cluster's scheduler may take to answer [s]."""

Batch = tuple[SessionJob, ...]
Parallel = Callable[[Iterable[Any]], Iterator[tuple[str, list[Row]]]]


class Backend(Enum):
    """Where the sessions run."""

    LOKY = "loky"
    """Processes on this machine."""
    DASK = "dask"
    """A Dask cluster."""
    RAY = "ray"
    """A Ray cluster."""


class Lost(NamedTuple):
    """A session whose worker died each time."""

    job: SessionJob
    reason: str


class Progress(NamedTuple):
    """What came of some of the sessions."""

    rows: list[Row]
    """Rows of those that are done."""
    lost: Lost | None
    """One that was given up."""


class Extra(Enum):
    """Extras of the package, with the modules that they bring."""

    STUDY = "study"
    DASK = "dask"
    RAY = "ray"

    @property
    def modules(self) -> tuple[str, ...]:
        """What must be there."""
        return {
            Extra.STUDY: ("joblib", "pyarrow"),
            Extra.DASK: ("dask", "distributed"),
            Extra.RAY: ("ray",),
        }[self]


def require_study() -> None:
    """Refuse to go on without what every study needs.

    Raises:
        ConfigurationError: Says what to install.
    """
    _require(Extra.STUDY)


def run_batch(key: str, batch: Batch, run: Callable[[SessionJob], Row]) -> tuple[str, list[Row]]:
    """Run a batch's sessions one after the other, in a worker; returns the batch's key and the rows."""
    return key, [run(job) for job in batch]


def execute(
    jobs: Sequence[SessionJob],
    *,
    workers: int,
    backend: Backend = Backend.LOKY,
    address: str | None = None,
    batch: int = BATCH,
    run: Callable[[SessionJob], Row] = run_session,
) -> Iterator[Progress]:
    """Run sessions, and give out what is done as it comes, in any order.

    The sessions of a batch whose worker died are tried again, each in a batch of its own while nothing else
    runs; one whose worker dies again is named, and the rest goes on.

    Args:
        jobs: The sessions.
        workers: Processes of this machine; 1 runs them in this one, where a dying one ends the study.
        backend: Where they run.
        address: Of the cluster's scheduler.
        batch: Sessions of a batch.
        run: What runs one session.

    Raises:
        ConfigurationError: The backend is not installed, or the cluster cannot be reached.
    """
    waiting = {jobs[i].key: tuple(jobs[i : i + batch]) for i in range(0, len(jobs), batch)}
    with _parallel(backend, workers, address) as parallel:
        deaths = _deaths()
        while waiting:
            started: list[str] = []
            try:
                for key, rows in parallel(_feed(waiting, started, run)):
                    del waiting[key]
                    yield Progress(rows, None)
            except deaths:
                suspects = [waiting.pop(key) for key in started if key in waiting]
                for job in itertools.chain.from_iterable(suspects):
                    try:
                        for _, rows in parallel(_feed({job.key: (job,)}, [], run)):
                            yield Progress(rows, None)
                    except deaths as error:
                        yield Progress([], Lost(job, f"its worker died twice: {type(error).__name__}"))


def _feed(
    waiting: Mapping[str, Batch], started: list[str], run: Callable[[SessionJob], Row]
) -> Iterator[Any]:
    """Tasks for the workers, as they ask for them, noting which were handed out."""
    import joblib

    for key, batch in list(waiting.items()):
        started.append(key)
        yield joblib.delayed(run_batch)(key, batch, run)


def _deaths() -> tuple[type[BaseException], ...]:
    """What a backend raises where a worker died."""
    found: list[type[BaseException]] = [BrokenProcessPool]
    if "distributed" in sys.modules:
        found.append(sys.modules["distributed"].scheduler.KilledWorker)
    if "ray" in sys.modules:
        found.append(sys.modules["ray"].exceptions.RayError)
    return tuple(found)


@contextlib.contextmanager
def _parallel(backend: Backend, workers: int, address: str | None) -> Iterator[Parallel]:
    """The one call that runs tasks, on whichever backend."""
    _require(Extra.STUDY)
    import joblib

    def parallel(tasks: Iterable[Any]) -> Iterator[tuple[str, list[Row]]]:
        call = joblib.Parallel(return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs")
        results: Iterator[tuple[str, list[Row]]] = call(tasks)
        return results

    if backend is Backend.LOKY:
        if address is not None:
            raise ConfigurationError("--address", "names a cluster; give --backend dask or ray with it")
        with joblib.parallel_config(backend="loky", n_jobs=workers, inner_max_num_threads=1):
            yield parallel
    elif backend is Backend.DASK:
        _require(Extra.DASK)
        with _dask_client(address, workers), joblib.parallel_config(backend="dask", n_jobs=-1):
            yield parallel
    else:
        _require(Extra.RAY)
        with _ray(address, workers), joblib.parallel_config(backend="ray", n_jobs=-1):
            yield parallel


@contextlib.contextmanager
def _dask_client(address: str | None, workers: int) -> Iterator[None]:
    from distributed import Client

    try:
        client = (
            Client(n_workers=workers, threads_per_worker=1, dashboard_address=None)
            if address is None
            else Client(address, timeout=CONNECT_S)
        )
    except (OSError, ValueError) as error:
        raise ConfigurationError("--address", f"no Dask scheduler at {address!r}: {error}") from error
    with client:
        yield


@contextlib.contextmanager
def _ray(address: str | None, workers: int) -> Iterator[None]:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray
    from ray.util.joblib import register_ray

    register_ray()
    try:
        if address is None:
            ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False)
        else:
            ray.init(address=address, log_to_driver=False)
    except (ConnectionError, ValueError) as error:
        raise ConfigurationError("--address", f"no Ray cluster at {address!r}: {error}") from error
    try:
        yield
    finally:
        ray.shutdown()


def _require(extra: "Extra") -> None:
    missing = [name for name in extra.modules if importlib.util.find_spec(name) is None]
    if missing:
        raise ConfigurationError(
            "hm study",
            f"{' and '.join(missing)} {'are' if len(missing) > 1 else 'is'} not installed; "
            f'in the clone, .venv/bin/pip install ".[{extra.value}]"',
        )
