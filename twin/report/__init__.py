"""The report of a run: one self-contained HTML file, its figures as PNG, all numbers as JSON."""

from twin.report.page import write_report
from twin.report.summary import write_summary

__all__ = ["write_report", "write_summary"]
