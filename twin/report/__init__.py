"""The report of a run: one self-contained HTML file, and its figures as PNG."""

from twin.report.page import write_report

__all__ = ["write_report"]
