"""The report as one HTML page: no script, nothing loaded from elsewhere, fit for print."""

import json
import math
from collections.abc import Iterable, Mapping
from html import escape

from teaching.evaluation import ForceError
from tools.report import words
from tools.report.session_data import SESSION_METADATA, SessionData
from tools.report.style import STYLE
from tools.report.summary import Analysis, Summary


def render(analysis: Analysis, figures: Mapping[str, str]) -> str:
    """The whole page.

    Args:
        analysis: The session.
        figures: SVG elements by name.
    """
    data, summary = analysis.data, analysis.summary
    title = f"Teaching session: {data.task.name}"
    body = "\n".join(
        (
            f"<header><h1>{escape(title)}</h1>{_origin(data)}</header>",
            _notes(words.notes(analysis)),
            _cards(analysis),
            _figure(figures, "learning", "How the skill grew", words.learning(analysis)),
            _figure(figures, "execution", "Who did what, and when", words.execution(analysis)),
            _figure(figures, "run-maps", "The autonomous run", words.run_maps(analysis)),
            _figure(figures, "run-course", "Why the borders are hard", words.borders(analysis)),
            f"<section><h2>The numbers</h2>{_session_table(summary, data)}{_error_table(summary)}</section>",
            _figure(figures, "handle", "The handle and its reference", words.handle(analysis)),
            _figure(figures, "mapping", "The task within the arm's reach", words.mapping(analysis)),
            _figure(figures, "timing", "Timing of the loop", words.timing(analysis)),
            _events(data),
            _configuration(data),
        )
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _origin(data: SessionData) -> str:
    session = data.metadata.get(SESSION_METADATA, {})
    parts = [f"{name} {value}" for name, value in session.items() if value and len(value) <= 80]
    described = " · ".join(escape(part) for part in [data.path.name, *parts])
    description = f"<p>{escape(data.task.description)}.</p>" if data.task.description else ""
    return f'{description}<p class="origin">{described}</p>'


def _notes(notes: Iterable[str]) -> str:
    return "".join(f'<p class="note">{escape(note)}</p>' for note in notes)


def _cards(analysis: Analysis) -> str:
    summary = analysis.summary
    run = summary.run.force
    cards = [
        ("Coverage of the plane", f"{100.0 * summary.coverage:.1f} %", f"{summary.models} models"),
        ("Updates", f"{summary.updates}", f"{summary.samples} samples"),
        (
            "Force error of the skill",
            _newtons(summary.grid.inside.mean),
            "mean inside the objects, on the grid",
        ),
        ("Force error of the run", _newtons(run.inside.mean), "mean inside the objects, measured"),
        ("Session", _duration(summary.session_s), f"{_duration(summary.teaching_s)} of it teaching"),
        (
            "Missed periods",
            f"{summary.missed_periods}",
            f"of {summary.cycles + summary.missed_periods} of the loop",
        ),
    ]
    items = "".join(
        f'<div class="card"><span class="name">{escape(name)}</span><span class="value">{escape(value)}</span>'
        f'<span class="more">{escape(more)}</span></div>'
        for name, value, more in cards
    )
    return f'<div class="cards">{items}</div>'


def _figure(figures: Mapping[str, str], name: str, title: str, text: Iterable[str]) -> str:
    svg = figures.get(name)
    if svg is None:
        return ""
    label = f'role="img" aria-label="{escape(title, quote=True)}"'
    paragraphs = "".join(f"<p>{paragraph}</p>" for paragraph in text)
    labelled = svg.replace("<svg", f"<svg {label}", 1)
    return (
        f'<section id="{name}"><h2>{escape(title)}</h2><figure>{labelled}'
        f"<figcaption>{paragraphs}</figcaption></figure></section>"
    )


def _session_table(summary: Summary, data: SessionData) -> str:
    late = summary.lateness_us
    lateness = (
        "no meaning on a virtual clock"
        if data.is_virtual
        else f"median {late.p50:.0f}, 99 % {late.p99:.0f}, 99.9 % {late.p99_9:.0f}, largest {late.max:.0f} µs"
    )
    updates = ", ".join(f"{time:.1f}" for time in summary.update_times_s) or "–"
    rows = [
        ("Updates of the skill", f"{summary.updates}"),
        ("… taken over at", f"{updates} s"),
        ("Samples learned", f"{summary.samples}"),
        (
            "Models added / pruned / present",
            f"{summary.models_added} / {summary.models_pruned} / {summary.models}",
        ),
        ("Coverage (80 × 80 points with w_max ≥ w_th)", f"{100.0 * summary.coverage:.2f} %"),
        ("Changes of control while teaching", f"{summary.hand_overs}"),
        (
            "Duration: practice / teaching / autonomous",
            f"{summary.practice_s:.1f} / {summary.teaching_s:.1f} / {summary.autonomous_s:.1f} s",
        ),
        ("Session", f"{summary.session_s:.1f} s"),
        ("Cycles of the loop, missed periods", f"{summary.cycles}, {summary.missed_periods}"),
        ("Lateness of the loop", lateness),
        ("Messages lost on the way to the log", f"{summary.lost_messages}"),
    ]
    body = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td>{escape(value)}</td></tr>' for name, value in rows
    )
    return f'<table class="facts"><tbody>{body}</tbody></table>'


def _error_table(summary: Summary) -> str:
    rows = [
        ("grid", "learned skill on 80 × 80 points, |K y − F_ref|", summary.grid),
        ("run", "measured in the autonomous run, |F − F_ref|", summary.run.force),
        ("", "of it, skill: |K y − F_ref|", summary.run.skill),
        ("", "of it, rendering: K |z_handle − z_ref|", summary.run.rendering),
    ]
    body = "".join(
        f'<tr><th scope="row">{escape(short)}</th><td class="text">{escape(name)}</td>{_errors(error)}</tr>'
        for short, name, error in rows
    )
    head = (
        '<tr><th rowspan="2"></th><th rowspan="2">Force error [N]</th><th colspan="3">overall</th>'
        '<th colspan="3">inside (&gt; 4 cm from a border)</th><th colspan="3">within 2 cm of a border</th></tr>'
        "<tr>" + "<th>mean</th><th>95 %</th><th>largest</th>" * 3 + "</tr>"
    )
    return f'<table class="errors"><thead>{head}</thead><tbody>{body}</tbody></table>'


def _errors(error: ForceError) -> str:
    cells = []
    for spread in error:
        for value in spread:
            cells.append(f"<td>{'–' if math.isnan(value) else f'{value:.2f}'}</td>")
    return "".join(cells)


def _events(data: SessionData) -> str:
    if not data.events:
        return ""
    rows = "".join(
        f"<tr><td>{event.time_s:.2f}</td><td class='text'>{escape(event.name)}</td>"
        f"<td class='text'>{escape(event.text)}</td></tr>"
        for event in data.events
    )
    return (
        f"<details><summary>Events ({len(data.events)})</summary><table class='events'><thead><tr><th>Time [s]</th>"
        f"<th class='text'>Event</th><th class='text'>What happened</th></tr></thead><tbody>{rows}</tbody></table></details>"
    )


def _configuration(data: SessionData) -> str:
    parts = {
        "metadata": {name: dict(values) for name, values in data.metadata.items()},
        "config": dict(data.config),
    }
    text = escape(json.dumps(parts, indent=2, ensure_ascii=False))
    return f"<details><summary>Configuration and origin</summary><pre>{text}</pre></details>"


def _newtons(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.2f} N"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{int(seconds // 60)} min {seconds % 60:.0f} s"
