"""What the report says in words of each figure. Paragraphs are HTML; numbers come from the log."""

import math
from html import escape
from typing import Final

import numpy as np

from tools.report.session_data import AUTONOMOUS, SESSION_METADATA, TEACHING
from tools.report.summary import Analysis

LEARNERS: Final = {
    "lwr": "the paper's",
    "multi": "ours",
    "rfwr": "Schaal and Atkeson 1998",
    "lwpr": "Vijayakumar, D'Souza and Schaal 2005",
}
"""Whose each kind of learner is."""
ARBITRATIONS: Final = {
    "paper": "the paper's eq. (9)",
    "confidence": "ours",
    "error": "ours, in the spirit of the paper's [7], whose formula is not public",
    "success": "ours, in the spirit of the paper's [24], whose formula is not public",
    "button": "ours, in the spirit of HG-DAgger (Kelly et al. 2019)",
}
"""Whose each kind of arbitration is."""


def sources(learner: str, arbitration: str) -> str:
    """Whose learner and arbitration are, by their kinds; plain text."""
    named = (
        ("Learner", learner, LEARNERS.get(learner)),
        ("Arbitration", arbitration, ARBITRATIONS.get(arbitration)),
    )
    return " ".join(f"{what} {kind}: {whose or 'unknown'}." for what, kind, whose in named)


def notes(analysis: Analysis) -> list[str]:
    """What the reader must know before he believes the rest."""
    data, summary = analysis.data, analysis.summary
    found = []
    if data.damage:
        found.append(f"The log is not whole: {data.damage}. This report shows what could be read.")
    if summary.lost_messages:
        found.append(f"{summary.lost_messages} messages did not get into the log.")
    if not summary.updates:
        found.append("The skill was never updated in this session: there is nothing learned to show.")
    if not np.any(data.ticks.stage == AUTONOMOUS):
        found.append("The session ended before the autonomous run.")
    found += [event.text for event in data.events if event.level >= 4]
    return found


def learning(analysis: Analysis) -> list[str]:
    """The paper's Fig. 4."""
    data = analysis.data
    shown = min(len(data.skills), 6)
    some = f"{shown} of {len(data.skills)} updates are shown." if shown < len(data.skills) else ""
    first = f"""The counterpart of the paper's Fig. 4. Each column is the skill after an update, with the
        time at which it was taken over. {some} <b>Top:</b> the displacement of the commanded position that
        the skill predicts; lines are the borders between objects. <b>Middle:</b> the error of the force
        that it would produce, |K&nbsp;y − {data.task.reference_force:g}&nbsp;N|. <b>Bottom:</b> the path of
        the manipulator up to the end of the examination that followed the update: black where the human was
        in control, green where the skill was; red crosses are the centres of the local models, blue
        ellipses where they are activated by w<sub>th</sub> = {data.w_th:g}."""
    second = """Grey areas have no model yet: there control is the human's. The paper shows its full error
        there."""
    return [first, second]


def execution(analysis: Analysis) -> list[str]:
    """The paper's Fig. 5."""
    ticks = analysis.data.ticks
    teaching = ticks.stage == TEACHING
    share = ""
    if teaching.any():
        share = f"""While teaching, the human was in control for {
            100.0 * np.mean(ticks.C[teaching] >= 1.0):.0f} % of the time, and control changed hands {
            analysis.summary.hand_overs
        } times."""
    text = f"""The counterpart of the paper's Fig. 5. <b>Top:</b> force between manipulator and surface
        against its reference; numbered dots mark the updates. <b>Below:</b> the control factor C of eq.
        (9), the manipulator's position in the plane, and the object under it. {share} After an update the
        human first moves about where the skill has models and watches it (C = 0); then he goes on where it
        has none (C = 1). Force peaks stand where the manipulator crosses a border: the depth that was right
        on one object is wrong on the next until it has been corrected."""
    return [text]


def run_maps(analysis: Analysis) -> list[str]:
    """Maps of the autonomous run."""
    run = analysis.summary.run
    first = """The human has let go; the skill takes the manipulator over the whole plane by itself.
        <b>Left:</b> the error of the measured force along the path. <b>Middle:</b> what of it is the
        skill's, had the arm followed perfectly. <b>Right:</b> what the arm adds by not being exactly where
        it was told to be. The two may cancel: they need not add up."""
    second = f"""Inside the objects the mean error is {_n(run.force.inside.mean)}, where the skill alone
        would make {_n(run.skill.inside.mean)} and the rendering {_n(run.rendering.inside.mean)}; within 2
        cm of a border it is {_n(run.force.border.mean)}."""
    return [first, second]


def borders(analysis: Analysis) -> list[str]:
    """Why the error at the borders is large."""
    data = analysis.data
    first = """<b>Left:</b> the error of the run over time; narrow peaks are crossings of a border, broad
        ones are lines that run along one. <b>Right:</b> the error by the distance from the nearest border:
        lines are means, bands reach to the 95 % quantile."""
    step = _largest_step(analysis)
    if step is None or not analysis.summary.models:
        return [first]
    soft, hard = step
    reference = data.task.reference_force
    radius = 100.0 * math.sqrt(-2.0 * math.log(data.w_th) / np.median(np.linalg.eigvalsh(data.skills[-1].D)))
    second = f"""The error at the borders is a property of the method, and the paper states it (Section 6):
        there the right depth jumps, at worst from {1e3 * reference / soft:.0f} mm on {soft:g} N/m to {
        1e3 * reference / hard:.0f} mm on {
        hard:g} N/m. The skill is a blend of overlapping linear models, each
        with a reach of about {radius:.1f} cm; it cannot jump and passes through the depths between, too
        deep for the harder side and too shallow for the softer. The band is as wide as a receptive field,
        and more samples do not remove it; narrower fields, or fields that adapt their shape, would make it
        narrower."""
    return [first, second]


def handle(analysis: Analysis) -> list[str]:
    """Reference and handle."""
    summary = analysis.summary
    first = """<b>Top:</b> depth of the handle below the surface (drawn downwards), and the reference of
        position mode while it is engaged: C &lt; 1 and the autonomous run. <b>Bottom:</b> the first hand-over
        to the skill, with the commanded forces of the two virtual springs: the assist that helps the human to
        hold his own height, and the spring of position mode. They are ramped at a hand-over."""
    paragraphs = [first]
    change, rendering = summary.force_change_n_per_ms, summary.run.rendering.overall.mean
    if math.isfinite(change):
        paragraphs.append(
            f"The command changed the position spring's force in z by {change:.2f} N per ms at most."
        )
    if math.isfinite(rendering):
        paragraphs.append(
            f"In the autonomous run the handle missed its reference by {_n(rendering)} of force on average."
        )
    return paragraphs


def mapping(analysis: Analysis) -> list[str]:
    """The plane in the arm's reach."""
    task = analysis.data.task
    sx, sy, sz = task.scale
    ox, oy, oz = task.offset
    text = f"""The plane of {task.size:g} m by {task.size:g} m lies in the reach of the arm at a scale:
        manipulator = scale × (handle − offset), with scale ({sx:g}, {sy:g}, {sz:g}) and offset ({ox:g},
        {oy:g}, {oz:g}) m, so that the handle moves over {task.size / sx:.3f} m by {task.size / sy:.3f} m.
        <b>Left:</b> from above, the user sits at the bottom. <b>Right:</b> from the side; the reach is
        drawn for the middle of the base's rotation. All other lengths and speeds in this report are the
        manipulator's."""
    return [text]


def timing(analysis: Analysis) -> list[str]:
    """Timing of the loop."""
    data, summary = analysis.data, analysis.summary
    if data.is_virtual:
        return ["The session ran in lock-step on a virtual clock: lateness has no meaning here."]
    scheduling = data.metadata.get(SESSION_METADATA, {}).get("scheduling", "")
    granted = f"Scheduling: {escape(scheduling)}." if scheduling else ""
    text = f"""How late the loop woke up behind its grid, and how often it was later than a given value.
        {summary.missed_periods} of {summary.cycles + summary.missed_periods} periods were missed.
        {granted}"""
    return [text]


def _largest_step(analysis: Analysis) -> tuple[float, float] | None:
    """Stiffness [N/m] on both sides of the border where the right depth jumps most; the softer first."""
    task = analysis.data.task
    found = None
    for (ax, ay), (bx, by) in task.border_segments:
        x, y = 0.5 * (ax + bx), 0.5 * (ay + by)
        length = math.hypot(bx - ax, by - ay)
        nx, ny = -1e-4 * (by - ay) / length, 1e-4 * (bx - ax) / length
        soft, hard = sorted((task.stiffness(x + nx, y + ny), task.stiffness(x - nx, y - ny)))
        if found is None or 1.0 / soft - 1.0 / hard > 1.0 / found[0] - 1.0 / found[1]:
            found = soft, hard
    return found


def _n(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.2f}&nbsp;N"
