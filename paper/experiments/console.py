"""What a person sees while experiments run (stderr), and what a script reads afterwards (stdout)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console as RichConsole
from rich.progress import Progress

from posefuse.foundation import plain


class Console:
    """Notes, warnings and bars on stderr; with `as_json` the figures go to stdout as one object."""

    def __init__(self, as_json: bool) -> None:
        self._as_json = as_json
        self._screen = RichConsole(stderr=True, highlight=False, soft_wrap=True)

    def note(self, text: str) -> None:
        """One line of news."""
        self._screen.print(text, markup=False)

    def warn(self, text: str) -> None:
        """One line about something that is not as it should be."""
        self._screen.print(f"warning: {text}", style="yellow", markup=False)

    def figures(self, figures: Mapping[str, Any]) -> None:
        """The one object of a run."""
        if self._as_json:
            print(json.dumps(plain(figures), indent=2), flush=True)

    @contextmanager
    def progress(self, label: str) -> Iterator[Callable[[int, int], None]]:
        """A bar that the callback (done, total) moves."""
        with Progress(console=self._screen) as bars:
            task = bars.add_task(label, total=None)
            yield lambda done, total: bars.update(task, completed=done, total=total)
