"""The paper's method against ours: ``python -m tools.bench.method --seeds 100:120``.

Every session is a row of a file of JSON lines. Rows that are there already are not run again, so that a run
that was stopped goes on where it was; a row counts for one configuration, task and seed. Takes about 4 s of a
core for a session.
"""

import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from cyclopts import App

from teaching.evaluation import GRID, judge
from teaching.learner import FloatArray
from teaching.task_file import load_task
from tools.cli.console import tell, write
from tools.run.fused import run_fused
from tools.run.options import load_options
from tools.run.request import TeachRequest
from tools.study.plan import SessionJob, digest
from tools.study.row import Row, Trail, run_session
from tools.study.statistics import Mean, mean_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

METHODS: Final = ("paper", "confident")
"""The paper's, and ours."""
FIGURES: Final = (
    ("grid_overall_mean", "grid overall [N]"),
    ("grid_inside_mean", "grid inside [N]"),
    ("grid_border_mean", "grid border [N]"),
    ("run_overall_mean", "run overall [N]"),
    ("run_inside_mean", "run inside [N]"),
    ("run_border_mean", "run border [N]"),
    ("auc_std", "AUC, deviation"),
    ("auc_w_max", "AUC, w_max"),
    ("share_wrong", "share wrong > 2 N"),
    ("teaching_s", "teaching [s]"),
    ("human_share", "human's share"),
    ("hand_overs", "hand-overs"),
    ("updates", "updates"),
    ("samples", "samples"),
    ("models", "models"),
)
"""Columns of a row, and their names in the table."""
_HIGHEST: Final = 6.0
"""Error at the end of the colour scale of the picture [N]."""


class Group(NamedTuple):
    """The sessions of a method on a task."""

    task: str
    method: str
    rows: list[Row]

    def mean(self, column: str) -> Mean:
        """Mean and 95 % interval of a column."""
        return mean_of(np.array([math.nan if row[column] is None else row[column] for row in self.rows]))


def job_of(task: str, method: str, seed: int, changes: Sequence[str] = ()) -> SessionJob:
    """The session that ``hm teach --fast --method METHOD --seed SEED`` runs on a task."""
    overrides = dict(change.split("=", 1) for change in changes)
    options = load_options(None, {"method": method, "task": task, **overrides}).value
    loaded = load_task(task)
    return SessionJob(key=digest(options, loaded, seed), options=options, task=loaded, seed=seed)


def measure(jobs: Iterable[tuple[str, str, SessionJob]], store: Path) -> list[Group]:
    """Run the sessions that the store does not have, and group all by task and method.

    Args:
        jobs: Task, method and session.
        store: File of JSON lines; made if it is not there.
    """
    known = {row["key"]: row for row in read(store)}
    if store.exists() and not store.read_bytes().endswith(b"\n"):
        with store.open("a", encoding="utf-8") as file:
            file.write("\n")  # behind a line that a stop cut off
    groups: dict[tuple[str, str], list[Row]] = {}
    for task, method, job in jobs:
        if job.key not in known:
            row = run_session(job)
            known[job.key] = {
                name: _plain(value) for name, value in row.items() if not name.startswith("curve")
            }
            with store.open("a", encoding="utf-8") as file:
                file.write(json.dumps(known[job.key] | {"task": task, "method": method}) + "\n")
            tell(f"{task} {method} {job.seed}: border {row['grid_border_mean']:.2f} N")
        groups.setdefault((task, method), []).append(known[job.key])
    return [Group(task, method, rows) for (task, method), rows in groups.items()]


def read(store: Path) -> list[Row]:
    """The rows of a store; a last line that was cut off is left out."""
    rows: list[Row] = []
    if not store.exists():
        return rows
    for line in store.read_text(encoding="utf-8").splitlines():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def table(groups: Sequence[Group]) -> list[str]:
    """Means with their 95 % intervals, as a table of Markdown, and how far ours is below the paper's."""
    heads = [f"{group.task}, {group.method}" for group in groups]
    lines = ["| | " + " | ".join(heads) + " |", "| --- |" + " --- |" * len(heads)]
    lines.append("| sessions | " + " | ".join(str(len(group.rows)) for group in groups) + " |")
    for column, name in FIGURES:
        lines.append(f"| {name} | " + " | ".join(_shown(group.mean(column)) for group in groups) + " |")
    by_name = {(group.task, group.method): group for group in groups}
    for task in dict.fromkeys(group.task for group in groups):
        pair = [by_name.get((task, method)) for method in METHODS]
        if pair[0] is not None and pair[1] is not None:
            parts = [
                f"{place} {_below(pair[0], pair[1], f'grid_{place}_mean')}" for place in ("overall", "border")
            ]
            lines.append(f"\n{task}: below the paper's method by {', '.join(parts)}")
    return lines


def draw(task: str, seed: int, path: Path) -> None:
    """Draw the force error of both methods over the plane, side by side.

    Args:
        task: Name or file of the task.
        seed: Seed of both sessions.
        path: File; its suffix says the format.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({"svg.hashsalt": "method", "font.size": 12}):
        figure = Figure(figsize=(10.4, 5.0), layout="constrained")
        panels = figure.subplots(1, 2)
        image: Any = None
        titles = ("the paper's method", "existence and confidence (ours)")
        for axes, method, title in zip(panels, METHODS, titles, strict=True):
            job = job_of(task, method, seed)
            errors, centres = error_map(job)
            image = _draw_map(axes, job, errors, centres, title)
        figure.colorbar(
            image, ax=list(panels), label="force error |K y - F_ref| [N]", extend="max", shrink=0.85
        )
        figure.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None, dpi=90)


def error_map(job: SessionJob) -> tuple[FloatArray, FloatArray]:
    """Force error of a session's skill on the grid, shape (80, 80) [N], and the centres of its models [m]."""
    trail = Trail()
    run_fused(TeachRequest(options=job.options, task=job.task, seed=job.seed, output=Path()), trail)
    learner = trail.skills[-1][1]
    points = job.task.grid(GRID)
    force = job.task.stiffness_at(points) * judge(learner, job.task).y
    errors: FloatArray = np.abs(force - job.task.reference_force).reshape(GRID, GRID)
    return errors, learner.models.centres


def _draw_map(axes: "Axes", job: SessionJob, errors: FloatArray, centres: FloatArray, title: str) -> Any:  # noqa: ANN401 - matplotlib's image
    half = 0.5 * job.task.size
    image = axes.imshow(
        errors.T, origin="lower", extent=(-half, half, -half, half), cmap="magma_r", vmin=0.0, vmax=_HIGHEST
    )
    axes.plot(*centres.T, "+", color="#0072b2", markersize=4.0, markeredgewidth=0.7)
    for (ax, ay), (bx, by) in job.task.border_segments:
        axes.plot((ax, bx), (ay, by), color="#404040", linewidth=0.7, linestyle=(0, (4, 4)))
    axes.set(xlim=(-half, half), ylim=(-half, half), xlabel="x [m]", ylabel="y [m]")
    axes.set_title(f"{title}\nmean {errors.mean():.2f} N, {len(centres)} models", loc="left", size=12)
    return image


def _shown(mean: Mean) -> str:
    if not math.isfinite(mean.mean):
        return "-"
    digits = 0 if abs(mean.mean) >= 100.0 else 1 if abs(mean.mean) >= 10.0 else 3
    return f"{mean.mean:.{digits}f} ± {mean.half:.{digits}f}"


def _below(paper: Group, ours: Group, column: str) -> str:
    """By how much ours is below, with a 95 % interval from resampled pairs of seeds."""
    pairs = np.array(
        [[a[column], b[column]] for a, b in zip(paper.rows, ours.rows, strict=False)], dtype=float
    )
    rng = np.random.default_rng(0)
    drawn = pairs[rng.integers(len(pairs), size=(10_000, len(pairs)))].mean(axis=1)
    low, high = np.quantile(1.0 - drawn[:, 1] / drawn[:, 0], (0.025, 0.975))
    share = 1.0 - pairs[:, 1].mean() / pairs[:, 0].mean()
    return f"{100.0 * share:.0f} % ({100.0 * low:.0f} to {100.0 * high:.0f})"


def _plain(value: Any) -> Any:  # noqa: ANN401 - whatever a column holds
    return None if isinstance(value, float) and not math.isfinite(value) else value


app = App(name="method", help="Measure the paper's method against ours.")


@app.default
def main(
    *,
    seeds: str = "100:120",
    tasks: str = "paper,turned,steep",
    methods: str = ",".join(METHODS),
    set_: tuple[str, ...] = (),
    store: Path = Path("method.jsonl"),
    picture: Path | None = None,
) -> None:
    """Run what is missing and print the table.

    Args:
        seeds: First seed and the one after the last, as 100:120.
        tasks: Names or files of tasks, with commas between.
        methods: Names of methods, with commas between.
        set_: A value over the method's, as in arbitration.doubt=0.2; for both methods.
        store: File of the rows.
        picture: Draw both methods' errors of the first seed on the first task into this file, and end.
    """
    first, last = (int(part) for part in seeds.split(":"))
    names = tasks.split(",")
    if picture is not None:
        draw(names[0], first, picture)
        tell(f"picture: {picture}")
        return
    jobs = (
        (task, method, job_of(task, method, seed, set_))
        for seed in range(first, last)
        for task in names
        for method in methods.split(",")
    )
    for line in table(measure(jobs, store)):
        write(line)


if __name__ == "__main__":
    app()
