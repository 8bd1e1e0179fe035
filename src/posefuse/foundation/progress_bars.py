"""Progress bars on the terminal, one look for the command line and for `progress=True`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from posefuse.core import Progress

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress as Bars
    from rich.progress import TaskID


def progress_bars(console: Console) -> Bars:
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
    """What long work reports to: a bar per stage, and every message to `note`."""
    with progress_bars(console) as bars:
        tasks: dict[str, TaskID] = {}

        def report(stage: str, done: int, total: int | None, message: str = "") -> None:
            if message:
                note(message)
            if stage not in tasks and total is not None:
                tasks[stage] = bars.add_task(stage, total=total)
            if stage in tasks:
                bars.update(tasks[stage], completed=done, total=total)

        yield report
