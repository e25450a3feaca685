"""``hm study``: many sessions over methods, surfaces and parameters, and what they come to."""

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from tools.cli.console import tell, write, write_json, write_table

if TYPE_CHECKING:
    from tools.study.run import Outcome
    from tools.study.statistics import Results

_SWITCH = Parameter(negative="")
_SHIPPED = Path(__file__).parents[1] / "study"


def run(
    study: str,
    /,
    *,
    output: Path,
    jobs: int | None = None,
    backend: Literal["loky", "dask", "ray"] = "loky",
    address: str | None = None,
    batch: int | None = None,
    json: Annotated[bool, _SWITCH] = False,
) -> int:
    """Run the sessions of a study that the output does not have yet.

    Stop it whenever you like: the same command goes on where it stood. Results do not depend on the backend,
    the number of workers or the order. Exit code 1 if a session was lost because its worker died.

    Args:
        study: TOML file, or the name of a study that is shipped; hm study list names them.
        output: Directory of the results.
        jobs: Worker processes on this machine; default: one for each core.
        backend: loky runs on this machine; dask and ray on a cluster, or start a local one.
        address: Of the cluster's scheduler.
        batch: Sessions that a worker takes at a time; default: 4.
        json: Print the outcome as one JSON object, and nothing else on standard output.
    """
    from hm_driver.errors import ConfigurationError
    from tools.cli.failures import ExitCode
    from tools.study.execute import BATCH, Backend, require_study

    require_study()
    from tools.study.plan import load_study
    from tools.study.run import run_study

    for name, value in (("--jobs", jobs), ("--batch", batch)):
        if value is not None and value < 1:
            raise ConfigurationError(name, f"{value} must be at least 1")
    plan = load_study(_find(study))
    workers = jobs or _cores()
    tell(f"{plan.title}: {len(plan.jobs)} sessions in {len(plan.cases)} cases, {workers} workers")
    try:
        with _Bar() as bar:
            outcome = run_study(
                plan, output, workers=workers, backend=Backend(backend), address=address,
                batch=batch or BATCH, notify=bar.show,
            )  # fmt: skip
    except KeyboardInterrupt as error:
        error.add_note(f"what is done is in {output}; the same command goes on from there")
        raise
    for lost in outcome.lost:
        tell(f"lost: {lost.reason}; seed {lost.job.seed}, key {lost.job.key}")
    _tell_outcome(outcome, output, as_json=json)
    return ExitCode.FAILED if outcome.lost else ExitCode.OK


def show(directory: Path, /, *, pictures: Path | None = None, json: Annotated[bool, _SWITCH] = False) -> None:
    """Print the tables of a study, and draw its pictures.

    Means over the sessions of a case, with their 95 % intervals.

    Args:
        directory: The output of hm study run.
        pictures: Directory for the SVG files; default: that of the results.
        json: Print everything as one JSON object, and nothing else on standard output.
    """
    from tools.study.execute import require_study

    require_study()
    from tools.study.figures import draw
    from tools.study.statistics import load_results
    from tools.study.store import Store
    from tools.study.tables import cross_table, sensitivity_tables

    results = load_results(Store(directory))
    paths = draw(results, pictures or directory)
    if json:
        write_json(_plain(results) | {"pictures": [str(path) for path in paths]})
        return
    write(results.title)
    for table in (cross_table(results), *sensitivity_tables(results)):
        write("")
        for line in table:
            write(line)
    write("")
    for path in paths:
        write(f"picture  {path}")


def list_(*, json: Annotated[bool, _SWITCH] = False) -> None:
    """List the studies that are shipped, with their size."""
    from tools.study.plan import load_study

    rows = []
    for path in sorted(_SHIPPED.glob("*.toml")):
        plan = load_study(path)
        rows.append(
            {"name": path.stem, "title": plan.title, "cases": len(plan.cases), "sessions": len(plan.jobs),
             "path": str(path)}
        )  # fmt: skip
    if json:
        write_json({"studies": rows})
    else:
        write_table((str(row["name"]), f"{row['sessions']} sessions, {row['title']}") for row in rows)


class _Bar:
    """A progress bar on standard error; a line now and then where that is no terminal."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        console = Console(stderr=True)
        self._bar = Progress(
            TextColumn("sessions"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
            TextColumn("left"), TimeRemainingColumn(), console=console,
        )  # fmt: skip
        self._task = self._bar.add_task("sessions", total=None)

    def show(self, done: int, total: int) -> None:
        self._bar.update(self._task, completed=done, total=total)

    def __enter__(self) -> "_Bar":
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()


def _find(study: str) -> Path:
    shipped = _SHIPPED / f"{study}.toml"
    return shipped if "/" not in study and not study.endswith(".toml") and shipped.exists() else Path(study)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _tell_outcome(outcome: "Outcome", output: Path, *, as_json: bool) -> None:
    if as_json:
        write_json(
            {
                "sessions": outcome.sessions,
                "were_there": outcome.were_there,
                "ran": outcome.ran,
                "ended_early": outcome.ended_early,
                "lost": [
                    {"key": lost.job.key, "seed": lost.job.seed, "reason": lost.reason}
                    for lost in outcome.lost
                ],
                "output": str(output),
            }
        )
        return
    write_table(
        [
            ("sessions", f"{outcome.sessions}, {outcome.were_there} of them done before"),
            ("ran", f"{outcome.ran}, {outcome.ended_early} of them ended by an error or a trip"),
            ("lost", str(len(outcome.lost))),
            ("results", f"{output}; hm study show {output}"),
        ]
    )


def _plain(results: "Results") -> dict[str, Any]:
    def case(one: Any) -> dict[str, Any]:  # noqa: ANN401 - CaseResult, which is imported lazily
        return {
            "settings": dict(one.settings),
            "sessions": one.sessions,
            "wanted": one.wanted,
            "ended_early": one.ended_early,
            "share_autonomous": _finite(one.share_autonomous),
            "figures": {
                name: {"mean": _finite(mean.mean), "half": _finite(mean.half), "n": mean.n}
                for name, mean in one.figures.items()
            },
        }

    return {
        "title": results.title,
        "cross": [case(one) for one in results.cross],
        "sensitivity": {part: [case(one) for one in cases] for part, cases in results.sensitivity.items()},
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
