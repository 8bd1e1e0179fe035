"""What a person reads and what a script reads: the same figures, as tables or as one JSON object."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

from posefuse.foundation.parsing import column_texts

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from posefuse.core import Progress

_ANY_WIDTH = 10_000
# arguments of Python in messages of the library, and what they are called on the command line where that is another name
_ARGUMENT = re.compile(r"`(\w+)=([^`]*)`")
_OPTIONS = {
    "replace": "force", "rate_hz": "rate", "start_s": "start", "end_s": "end", "drift": "clocks drift", "max_offset_s": "most-s",
    "focal_known_to_percent": "refine-lenses", "camera_distance": "apart", "emergency_stop": "i-have-an-emergency-stop",
}  # fmt: skip
Advance = Callable[[int, int], None]
"""Progress callback: (done, total)."""


def in_options(text: str) -> str:
    """A message for a shell: an argument of Python, `` `clocks=offset` ``, is the option ``--clocks offset``."""

    def option(found: re.Match[str]) -> str:
        name, value = found.groups()
        return f"--{_OPTIONS.get(name, name.replace('_', '-'))}" + ("" if value == "True" else f" {value}")

    return _ARGUMENT.sub(option, text)


class Terminal:
    """Tables go to stdout; notes, warnings and progress to stderr. With `as_json` only the figures go to stdout."""

    def __init__(self, as_json: bool) -> None:
        self._as_json = as_json

    @cached_property
    def _notes(self) -> Console:
        from rich.console import Console

        return Console(stderr=True, highlight=False, soft_wrap=True)

    @cached_property
    def _tables(self) -> Console:
        from rich.console import Console

        return self._notes if self._as_json else Console(highlight=False)

    def note(self, text: str) -> None:
        """One line of news."""
        self._notes.print(in_options(text), markup=False)

    def warn(self, text: str) -> None:
        """One line about something that is not as it should be, with work going on."""
        self._notes.print(f"warning: {in_options(text)}", style="yellow", markup=False)

    def next(self, command: str, purpose: str) -> None:
        """One thing to do after this command; what it is good for."""
        self.note(f"next: {command}  ({purpose})")

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
        """A table; numbers are right-aligned, floats shown to a sensible digit."""
        from rich.table import Table
        from rich.text import Text

        numeric = [all(isinstance(row[i], int | float) or row[i] is None for row in rows) for i in range(len(columns))]
        shown = Table(title=Text(title), title_justify="left", title_style="bold", header_style="")
        for column, right in zip(columns, numeric, strict=True):
            shown.add_column(Text(column), justify="right" if right else "left", overflow="fold")
        for row in zip(*(_cells(column) for column in zip(*rows, strict=True)), strict=True):
            shown.add_row(*row)
        if self._tables.measure(shown, options=self._tables.options.update(width=_ANY_WIDTH)).maximum > self._tables.width:
            # narrow cells before broken words
            shown.padding = (0, 0)
        self._tables.print(shown)

    def facts(self, title: str, facts: Mapping[str, Any]) -> None:
        """A table of two columns without a header."""
        from rich.table import Table
        from rich.text import Text

        shown = Table(title=Text(title), title_justify="left", title_style="bold", show_header=False)
        for name, value in facts.items():
            shown.add_row(Text(name), *_cells([value]))
        self._tables.print(shown)

    def figures(self, figures: Mapping[str, Any]) -> None:
        """With --json: the one object on stdout."""
        from posefuse.foundation.parsing import plain

        if self._as_json:
            print(json.dumps(plain(figures), indent=2), flush=True)

    @contextmanager
    def progress(self, label: str) -> Iterator[Advance]:
        """A progress bar on stderr that the callback moves."""
        with self.stages() as report:
            yield lambda done, total: report(label, done, total)

    @contextmanager
    def stages(self) -> Iterator[Progress]:
        """What public functions report to: a bar on stderr per stage, and a line per message."""
        from posefuse.foundation.progress_bars import stage_bars

        with stage_bars(self._notes, self.note) as report:
            yield report


def _cells(column: Sequence[Any]) -> list[Text]:
    """Cells with their text as it is: square brackets in names of files are no markup."""
    from rich.text import Text

    return [Text(in_options(text)) for text in column_texts(column, "-")]
