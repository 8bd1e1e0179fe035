"""Parts of the pages of the docs that commands write: between <!-- NAME: begin --> and <!-- NAME: end -->."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable, Sequence
from datetime import date
from pathlib import Path


def between_marks(page: Path, name: str) -> tuple[str, str, str]:
    """The text of a page up to the mark that begins this name's part, the part, and the text from the mark that ends it."""
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"
    before, first, rest = page.read_text(encoding="utf-8").partition(begin)
    part, last, after = rest.partition(end)
    if not (first and last):
        raise SystemExit(f"{page}: expected the marks {begin.strip()} and {end}")
    return before + begin, part, end + after


def write_between_marks(page: Path, text: str, name: str) -> None:
    """Replace the part of this name."""
    before, _, after = between_marks(page, name)
    page.write_text(f"{before}{text}\n{after}", encoding="utf-8")


def markdown(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (columns, ["---"] * len(columns), *rows))


def processor() -> str:
    """The name of the machine's processor."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())


def made_by(command: str) -> str:
    """The command of a part, when it ran and where."""
    return f"`{command}`, {date.today()}, {processor()}, {os.cpu_count()} cores, Python {platform.python_version()}."
