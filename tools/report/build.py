"""From a log to a report."""

from pathlib import Path

from tools.report import page
from tools.report.figures import autonomous, drawing, execution, handle, learning, mapping, timing
from tools.report.session_data import load_session
from tools.report.summary import Analysis, Summary, analyse


def build_report(log_path: str | Path, output_path: str | Path) -> Summary:
    """Write the report of a session, from its log alone.

    Args:
        log_path: The session's MCAP file; it may be truncated.
        output_path: HTML file to write; one that is there is replaced.

    Returns:
        The numbers of the session.

    Raises:
        RecordingError: if the log cannot be read or holds no teaching session.
        OSError: if the report cannot be written.
    """
    analysis = analyse(load_session(log_path))
    html = page.render(analysis, draw_figures(analysis))
    Path(output_path).write_text(html, encoding="utf-8")
    return analysis.summary


def draw_figures(analysis: Analysis) -> dict[str, str]:
    """The figures as SVG, by name; those that the log has no data for are left out."""
    data = analysis.data
    figures: dict[str, str] = {}
    with drawing.context():
        if data.skills:
            figures["learning"] = drawing.to_svg(learning.draw(analysis), "learning")
        figures["execution"] = drawing.to_svg(execution.draw(analysis), "execution")
        if len(analysis.run.time_s):
            figures["run-maps"] = drawing.to_svg(autonomous.draw_maps(analysis), "run-maps")
            figures["run-course"] = drawing.to_svg(autonomous.draw_course(analysis), "run-course")
        if len(data.cycles.time_s):
            figures["handle"] = drawing.to_svg(handle.draw(data), "handle")
            figures["timing"] = drawing.to_svg(timing.draw(data), "timing")
        figures["mapping"] = drawing.to_svg(mapping.draw(data), "mapping")
    return figures
