"""The report of a session: from a log to one self-contained HTML file."""

from tools.report.build import build_report
from tools.report.summary import Summary

__all__ = ["Summary", "build_report"]
