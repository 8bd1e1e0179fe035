"""What `progress=` of the public functions accepts: nothing, a bar on the terminal, or a function."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from posefuse.core import Progress, silent


@contextmanager
def shown(progress: Progress | bool | None) -> Iterator[Progress]:
    """The function to report to: the one given, bars on stderr for True, or one that shows nothing for None and False."""
    if progress is None or progress is False:
        yield silent
    elif progress is True:
        with _bars() as report:
            yield report
    else:
        yield progress


@contextmanager
def _bars() -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    console = Console(file=sys.stderr, highlight=False, soft_wrap=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=console, refresh_per_second=4) as bars:
        tasks: dict[str, TaskID] = {}

        def report(stage: str, done: int, total: int | None, message: str = "") -> None:
            if message:
                console.print(message, markup=False)
            if total is None and done == 0:
                return
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield report
