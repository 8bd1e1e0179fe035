"""One self-contained HTML page about a recording."""

from .page import write_report

__all__ = ["write_report"]
