"""The report about a recording: one page for people who are not engineers."""

from .page import report_page, write_report

__all__ = ["report_page", "write_report"]
