"""A run as one HTML page: pictures, tables and the verdict, nothing loaded from elsewhere."""

import json
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from hm_driver.errors import ConfigurationError
from tools.jitter import figures
from tools.jitter.compare import Comparison
from tools.jitter.result import CyclictestResult, Run, ScenarioResult
from tools.jitter.table import PERCENTILES, QUANTITIES, facts, microseconds, percentiles
from tools.report.figures import drawing
from tools.report.style import STYLE

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
_MORE_STYLE = """
td.bad { color: #b34700; font-weight: 650; }
.facts-list { margin: .2rem 0 1rem; padding-left: 1.2rem; font-size: .95rem; }
.good { border-left-color: #009e73; background: #eef8f4; }
table.scroll { display: block; overflow-x: auto; }
"""


def save_report(run: Run, path: Path) -> None:
    """Write the page of a run.

    Raises:
        ConfigurationError: The file cannot be written.
    """
    _write(path, render(run))


def save_comparison(comparison: Comparison, path: Path) -> None:
    """Write the page of two runs beside each other.

    Raises:
        ConfigurationError: The file cannot be written, or the runs share no scenario.
    """
    if not comparison.rows:
        raise ConfigurationError("compare", f"{' and '.join(comparison.names)} have no scenario in common")
    with drawing.context():
        svg = drawing.to_svg(figures.draw_comparison(comparison), "comparison")
    title = "Two runs of the jitter suite"
    notes = "".join(f'<p class="note">{escape(text)}</p>' for text in comparison.differences)
    origin = f"first {comparison.names[0]} · second {comparison.names[1]}"
    body = (
        f'<header><h1>{title}</h1><p class="origin">{escape(origin)}</p></header>{notes}'
        f"{_figure('ratios', 'Ratios', svg, ['The grey band from 0.8 to 1.25 guides the eye.'])}"
    )
    _write(path, _PAGE.format(title=title, style=STYLE + _MORE_STYLE, body=body))


def render(run: Run) -> str:
    """The whole page of a run."""
    limits = run.options["limits"]
    title = "Jitter of the loop"
    parts = [f"<header><h1>{title}</h1>{_origin(run)}</header>", _verdict(run), _cards(run.scenarios)]
    with drawing.context():
        if run.scenarios:
            overview = figures.draw_overview(
                run.scenarios, p99_9_limit=limits["excess_p99_9_us"], max_limit=limits["excess_max_us"]
            )
            svg = drawing.to_svg(overview, "overview")
            parts.append(_figure("overview", "All scenarios", svg, _overview_words()))
            parts.append(_table(run.scenarios, limits["excess_p99_9_us"], limits["excess_max_us"]))
        if run.cyclictest is not None:
            svg = drawing.to_svg(figures.draw_cyclictest(run.cyclictest), "cyclictest")
            parts.append(_figure("cyclictest", "Beside cyclictest", svg, _sliced_words(run.cyclictest)))
        for number, result in enumerate(run.scenarios):
            svg = drawing.to_svg(figures.draw_scenario(result), f"scenario{number}")
            title_ = f"Scenario {result.name}"
            parts.append(_figure(f"scenario-{number}", title_, svg, [], more=_facts(result)))
    parts.append(_details(run))
    return _PAGE.format(title=title, style=STYLE + _MORE_STYLE, body="\n".join(parts))


def _origin(run: Run) -> str:
    host = run.host
    described = (
        run.started, host.get("name", ""), host.get("processor", ""), f"{host.get('cpus', '?')} CPUs",
        host.get("system", ""), host.get("python", ""), f"version {run.version}",
    )  # fmt: skip
    text = " · ".join(part for part in described if part)
    rate, loop = run.options["rate_hz"], run.options["loop"]
    told = f"The loop at {rate:g} Hz in a {loop}"
    told += " of its own, against an emulator over TCP" if loop == "process" else " of the application"
    if run.options["fault"]:
        told += f", with the fault '{run.options['fault']}' put into it"
    if run.options["is_unprivileged"]:
        told += ", without any privilege"
    return f'<p>{escape(told)}.</p><p class="origin">{escape(text)}</p>'


def _verdict(run: Run) -> str:
    bad = [check for check in run.checks if not check["passed"]]
    if not bad:
        return f'<p class="note good">All {len(run.checks)} limits were kept.</p>'
    items = "".join(
        f"<li>{escape(check['scenario'])}: {escape(check['name'])}: {check['value']:.4g} where "
        f"{check['limit']:g} is allowed{escape(': ' + check['detail'] if check['detail'] else '')}</li>"
        for check in bad
    )
    return (
        f'<div class="note">{len(bad)} of {len(run.checks)} limits were exceeded:'
        f'<ul class="facts-list">{items}</ul></div>'
    )


def _cards(results: Sequence[ScenarioResult]) -> str:
    if not results:
        return ""
    judged = [result for result in results if result.excess.samples]
    periods = sum(result.window_cycles + result.window_missed for result in results)
    cards = [("Measured", f"{periods}", f"periods in {len(results)} scenarios")]
    if judged:
        worst = max(judged, key=lambda result: result.excess.p99_9)
        largest = max(judged, key=lambda result: result.excess.max)
        own = sum(result.own_missed or 0 for result in judged)
        cards += [
            ("Excess p99.9", f"{microseconds(worst.excess.p99_9)} µs", f"at worst, in {_spaced(worst.name)}"),
            ("Excess max", f"{microseconds(largest.excess.max)} µs", f"in {_spaced(largest.name)}"),
            ("Missed by our own doing", f"{own}", f"of {sum(r.window_missed for r in judged)} missed in all"),
        ]
    slowest = max(results, key=lambda result: result.response.p99)
    cards.append(
        ("Response p99", f"{microseconds(slowest.response.p99)} µs", f"at worst, in {_spaced(slowest.name)}")
    )
    items = "".join(
        f'<div class="card"><span class="name">{name}</span><span class="value">{value}</span>'
        f'<span class="more">{escape(more)}</span></div>'
        for name, value, more in cards
    )
    return f'<div class="cards">{items}</div>'


def _overview_words() -> list[str]:
    return [
        (
            "A <b>canary</b> sleeps to the same deadlines on the same CPU at a higher priority and does "
            "nothing else. What stalls it stalls the loop: the loop's wake-up minus the canary's is the "
            "loop's own <b>excess</b>. The canary runs first, so that the loop wakes later than alone."
        )
    ]


def _sliced_words(sliced: CyclictestResult) -> list[str]:
    return [
        (
            f"cyclictest, the loop and the loop without spin took turns of {sliced.slice_s:g} s on one CPU "
            f"at one priority. p99 of the loop over that of cyclictest: <b>{sliced.spin_ratio:.3f}</b> with "
            f"spin, <b>{sliced.no_spin_ratio:.3f}</b> without. Command: <code>{escape(sliced.command)}</code>"
        )
    ]


def _table(results: Sequence[ScenarioResult], p99_9_limit: float, max_limit: float | None) -> str:
    rows = []
    for result in results:
        shown = [(name, title) for name, title in QUANTITIES if getattr(result, name).samples]
        for place, (name, title) in enumerate(shown):
            cells = []
            for percentile, value in zip(PERCENTILES, percentiles(getattr(result, name)), strict=True):
                limit = {"p99.9": p99_9_limit, "max": max_limit}.get(percentile)
                is_bad = name == "excess" and limit is not None and value > limit
                cells.append(f"<td{' class=bad' if is_bad else ''}>{microseconds(value)}</td>")
            lead = (
                f'<th scope="rowgroup" rowspan="{len(shown)}">{escape(_spaced(result.name))}</th>'
                if not place
                else ""
            )
            rows.append(f'<tr>{lead}<td class="text">{title}</td>{"".join(cells)}</tr>')
    head = "".join(f"<th>{name}</th>" for name in PERCENTILES)
    return (
        '<section id="numbers"><h2>The numbers [µs]</h2><table class="scroll"><thead><tr><th>Scenario</th>'
        f'<th class="text">Quantity</th>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></section>'
    )


def _facts(result: ScenarioResult) -> str:
    lines = "".join(f"<li>{escape(line)}</li>" for line in facts(result))
    events = "".join(
        f"<tr><td>{event.time_s:.3f}</td><td>{microseconds(event.excess)}</td>"
        f"<td>{microseconds(event.lateness)}</td><td>{microseconds(event.canary)}</td>"
        f"<td>{microseconds(event.response)}</td></tr>"
        for event in sorted(result.worst, key=lambda event: -event.excess)[:10]
    )
    table = ""
    if events:
        head = "".join(
            f"<th>{name}</th>"
            for name in ("Time [s]", "Excess [µs]", "Lateness [µs]", "Canary [µs]", "Response [µs]")
        )
        table = (
            f"<details><summary>The largest excesses</summary><table><thead><tr>{head}</tr></thead>"
            f"<tbody>{events}</tbody></table></details>"
        )
    return f'<ul class="facts-list">{lines}</ul>{table}'


def _figure(name: str, title: str, svg: str, text: Iterable[str], *, more: str = "") -> str:
    labelled = svg.replace("<svg", f'<svg role="img" aria-label="{escape(title, quote=True)}"', 1)
    caption = "".join(f"<p>{paragraph}</p>" for paragraph in text)
    caption = f"<figcaption>{caption}</figcaption>" if caption else ""
    return (
        f'<section id="{name}"><h2>{escape(title)}</h2><figure>{labelled}{caption}</figure>{more}</section>'
    )


def _details(run: Run) -> str:
    text = escape(json.dumps({"options": run.options, "host": run.host}, indent=2, ensure_ascii=False))
    return f"<details><summary>Options and host</summary><pre>{text}</pre></details>"


def _spaced(name: str) -> str:
    return name.replace("+", " + ")


def _write(path: Path, html: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(html, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError("--output", f"{path} cannot be written: {error.strerror}") from error
