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
        from rich.console import Console

        from posefuse.foundation.progress_bars import stage_bars

        console = Console(file=sys.stderr, highlight=False, soft_wrap=True)
        with stage_bars(console, lambda line: console.print(line, markup=False)) as report:
            yield report
    else:
        yield progress
