"""The report's tables."""

import math

from teaching.evaluation import ForceError
from tools.report.metrics import Lateness
from tools.report.summary import Summary


def session_table(summary: Summary, *, is_virtual: bool) -> str:
    """What the session came to, one number a row."""
    updates = ", ".join(f"{time:.1f}" for time in summary.update_times_s)
    models = (summary.models_added, summary.models_pruned, summary.models)
    stages = (summary.practice_s, summary.teaching_s, summary.autonomous_s)
    rows = (
        ("Updates of the skill", f"{summary.updates}"),
        ("… taken over at", f"{updates} s" if updates else "–"),
        ("Samples learned", f"{summary.samples}"),
        ("Models added / pruned / present", " / ".join(str(count) for count in models)),
        (
            "Coverage (80 × 80 points with w<sub>max</sub> ≥ w<sub>th</sub>)",
            f"{100.0 * summary.coverage:.2f} %",
        ),
        ("Share of the plane that is wrong by more than 2 N", f"{100.0 * summary.share_wrong:.2f} %"),
        (
            "How well these places are told (0.5: not at all, 1: all), by deviation / by w<sub>max</sub>",
            f"{number(summary.auc_std)} / {number(summary.auc_w_max)}",
        ),
        ("Changes of control while teaching", f"{summary.hand_overs}"),
        ("Practice / teaching / autonomous run", " / ".join(f"{time:.1f}" for time in stages) + " s"),
        ("Session", f"{summary.session_s:.1f} s"),
        ("Cycles of the loop / missed periods", f"{summary.cycles} / {summary.missed_periods}"),
        (
            "Lateness of the loop",
            "no meaning on a virtual clock" if is_virtual else _lateness(summary.lateness_us),
        ),
        ("Cycles with a joint at its velocity limit", f"{summary.saturated_cycles}"),
        (
            "Largest change of the position spring's force in z by the command",
            f"{number(summary.force_change_n_per_ms)} N per ms",
        ),
        ("Messages lost on the way to the log", f"{summary.lost_messages}"),
    )
    body = "".join(f'<tr><th scope="row">{name}</th><td>{value}</td></tr>' for name, value in rows)
    return f'<table class="facts"><tbody>{body}</tbody></table>'


def error_table(summary: Summary) -> str:
    """Force errors of skill and run, overall, inside the objects and at their borders."""
    rows = (
        ("grid", "learned skill on 80 × 80 points, |K y − F<sub>ref</sub>|", summary.grid),
        ("run", "measured in the autonomous run, |F − F<sub>ref</sub>|", summary.run.force),
        ("", "… by the skill: |K y − F<sub>ref</sub>|", summary.run.skill),
        ("", "… by rendering: K |z<sub>handle</sub> − z<sub>ref</sub>|", summary.run.rendering),
    )
    body = "".join(
        f'<tr><th scope="row">{short}</th><td class="text">{name}</td>{_errors(error)}</tr>'
        for short, name, error in rows
    )
    groups = ("overall", "inside (&gt; 4 cm from borders)", "border (≤ 2 cm)")
    head = (
        '<tr><th rowspan="2"></th><th rowspan="2">Force error [N]</th>'
        + "".join(f'<th colspan="3">{group}</th>' for group in groups)
        + "</tr><tr>"
        + "<th>mean</th><th>95 %</th><th>largest</th>" * len(groups)
        + "</tr>"
    )
    return f'<table class="errors"><thead>{head}</thead><tbody>{body}</tbody></table>'


def number(value: float) -> str:
    """Two decimals; a dash for what there is not."""
    return "–" if math.isnan(value) else f"{value:.2f}"


def newtons(value: float) -> str:
    """A force with its unit."""
    return f"{number(value)} N"


def _errors(error: ForceError) -> str:
    return "".join(f"<td>{number(value)}</td>" for spread in error for value in spread)


def _lateness(late: Lateness) -> str:
    if math.isnan(late.max):
        return "–"
    return f"median {late.p50:.0f}, 99 % {late.p99:.0f}, 99.9 % {late.p99_9:.0f}, largest {late.max:.0f} µs"
