"""The report as one HTML page: no script, nothing loaded from elsewhere, fit for print."""

import json
from collections.abc import Iterable, Mapping
from html import escape

from tools.report import words
from tools.report.session_data import SESSION_METADATA, SessionData
from tools.report.style import STYLE
from tools.report.summary import Analysis
from tools.report.tables import error_table, newtons, session_table

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main>
{body}
</main>
</body>
</html>
"""


def render(analysis: Analysis, figures: Mapping[str, str]) -> str:
    """The whole page.

    Args:
        analysis: The session.
        figures: SVG elements by name.
    """
    data, summary = analysis.data, analysis.summary
    title = f"Teaching session: {data.task.name}"
    numbers = session_table(summary, is_virtual=data.is_virtual) + error_table(summary)
    parts = (
        f"<header><h1>{escape(title)}</h1>{_origin(data)}</header>",
        "".join(f'<p class="note">{escape(note)}</p>' for note in words.notes(analysis)),
        _cards(analysis),
        _figure(figures, "learning", "How the skill grew", words.learning(analysis)),
        _figure(figures, "execution", "Who did what, and when", words.execution(analysis)),
        _figure(figures, "run-maps", "The autonomous run", words.run_maps(analysis)),
        _figure(figures, "run-course", "Why the borders are hard", words.borders(analysis)),
        f'<section id="numbers"><h2>The numbers</h2>{numbers}</section>',
        _figure(figures, "handle", "The handle and its reference", words.handle(analysis)),
        _figure(figures, "mapping", "The task within the arm's reach", words.mapping(analysis)),
        _figure(figures, "timing", "Timing of the loop", words.timing(analysis)),
        _events(data),
        _configuration(data),
    )
    return document(title, "\n".join(parts))


def document(title: str, body: str) -> str:
    """A page of HTML in the report's style.

    Args:
        title: Its title, plain text.
        body: What it shows, HTML.
    """
    return _PAGE.format(title=escape(title), style=STYLE, body=body)


def _origin(data: SessionData) -> str:
    session = data.metadata.get(SESSION_METADATA, {})
    parts = [f"{name} {value}" for name, value in session.items() if value and len(value) <= 80]
    described = " · ".join(escape(part) for part in (data.path.name, *parts))
    description = f"<p>{escape(data.task.description)}.</p>" if data.task.description else ""
    kinds = [str(data.config.get(part, {}).get("kind", part)) for part in ("learner", "arbitration")]
    whose = f"<p>{escape(words.sources(*kinds))}</p>"
    return f'{description}{whose}<p class="origin">{described}</p>'


def _cards(analysis: Analysis) -> str:
    summary = analysis.summary
    periods = summary.cycles + summary.missed_periods
    cards = (
        ("Coverage of the plane", f"{100.0 * summary.coverage:.1f} %", f"{summary.models} models"),
        ("Updates", f"{summary.updates}", f"{summary.samples} samples"),
        ("Error of the skill", newtons(summary.grid.inside.mean), "mean inside the objects, grid"),
        ("Error of the run", newtons(summary.run.force.inside.mean), "mean inside the objects, measured"),
        ("Session", f"{summary.session_s:.0f} s", f"{summary.teaching_s:.0f} s of it teaching"),
        ("Missed periods", f"{summary.missed_periods}", f"of {periods} of the loop"),
    )
    items = "".join(
        f'<div class="card"><span class="name">{name}</span><span class="value">{value}</span>'
        f'<span class="more">{more}</span></div>'
        for name, value, more in cards
    )
    return f'<div class="cards">{items}</div>'


def _figure(figures: Mapping[str, str], name: str, title: str, text: Iterable[str]) -> str:
    svg = figures.get(name)
    if svg is None:
        return ""
    labelled = svg.replace("<svg", f'<svg role="img" aria-label="{escape(title, quote=True)}"', 1)
    caption = "".join(f"<p>{' '.join(paragraph.split())}</p>" for paragraph in text)
    figure = f"<figure>{labelled}<figcaption>{caption}</figcaption></figure>"
    return f'<section id="{name}"><h2>{escape(title)}</h2>{figure}</section>'


def _events(data: SessionData) -> str:
    if not data.events:
        return ""
    rows = "".join(
        f'<tr><td>{event.time_s:.2f}</td><td class="text">{escape(event.name)}</td>'
        f'<td class="text">{escape(event.text)}</td></tr>'
        for event in data.events
    )
    head = '<tr><th>Time [s]</th><th class="text">Event</th><th class="text">What happened</th></tr>'
    table = f'<table class="events"><thead>{head}</thead><tbody>{rows}</tbody></table>'
    return f"<details><summary>Events ({len(data.events)})</summary>{table}</details>"


def _configuration(data: SessionData) -> str:
    metadata = {name: dict(values) for name, values in data.metadata.items()}
    parts = {"metadata": metadata, "config": dict(data.config)}
    text = escape(json.dumps(parts, indent=2, ensure_ascii=False))
    return f"<details><summary>Configuration and origin</summary><pre>{text}</pre></details>"
