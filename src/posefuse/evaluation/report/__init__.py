"""The report about a recording: one page for people who are not engineers."""

from .page import TITLE, report_page, write_report

__all__ = ["TITLE", "report_page", "write_report"]
