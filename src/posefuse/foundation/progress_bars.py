"""Progress: bars on a terminal, lines elsewhere; one look for the command line and for `progress=True`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from posefuse.core import Progress

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

# a file or a pipe gets a line so often, and one at the end of each stage
_LINE_S = 30.0


def _bars(console: Console) -> Bars:
    """Bars with counts and times; a context manager that shows them."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    return Bars(*columns, console=console, refresh_per_second=4)


@contextmanager
def stage_bars(console: Console, note: Callable[[str], None]) -> Iterator[Progress]:
    """What long work reports to: a bar per stage, or lines where no terminal shows them; and every message to `note`."""
    if not (console.is_terminal or console.is_jupyter):
        yield _lines(note)
        return
    with _bars(console) as bars:
        tasks: dict[str, TaskID] = {}

        def report(stage: str, done: int, total: int | None, message: str = "") -> None:
            if message:
                note(message)
            if stage not in tasks and total is not None:
                tasks[stage] = bars.add_task(stage, total=total)
            if stage in tasks:
                bars.update(tasks[stage], completed=done, total=total)

        yield report


def _lines(note: Callable[[str], None]) -> Progress:
    noted_s: dict[str, float] = {}
    complete: set[str] = set()

    def report(stage: str, done: int, total: int | None, message: str = "") -> None:
        if message:
            note(message)
        now_s = time.monotonic()
        ends = done == total and stage not in complete
        if total and (ends or now_s - noted_s.setdefault(stage, now_s) > _LINE_S):
            noted_s[stage] = now_s
            complete.update([stage] if ends else [])
            note(f"{stage} {done}/{total}")

    return report
