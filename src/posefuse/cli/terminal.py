"""What a person reads and what a script reads: the same figures, as tables or as one JSON object."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from posefuse.core import Progress
    from posefuse.foundation.summary import Block

_ANY_WIDTH = 10_000
# arguments of Python in messages of the library, and what they are called on the command line where that is another name
_ARGUMENT = re.compile(r"`(\w+)=([^`]*)`")
_OPTIONS = {
    "replace": "force", "rate_hz": "rate", "start_s": "start", "end_s": "end", "drift": "clocks drift", "max_offset_s": "most-s",
    "focal_known_to_percent": "refine-lenses", "camera_distance": "apart",
    "domain_id": "domain", "peers": "peer", "align_time": "no-time", "align_space": "no-space", "align_first_s": "align-first",
    "loop_s": "loop", "settings": "set",
}  # fmt: skip


def quoted(value: object) -> str:
    """A path or word as a shell takes it."""
    return shlex.quote(str(value))


def option_of(argument: str) -> str:
    """What an argument of Python is called on the command line, without the dashes."""
    return _OPTIONS.get(argument, argument.replace("_", "-"))


def in_options(text: str) -> str:
    """A message for a shell: an argument of Python, `` `clocks=offset` ``, is the option ``--clocks offset``."""

    def option(found: re.Match[str]) -> str:
        name, value = found.groups()
        return f"--{option_of(name)}" + ("" if value in ("True", "False") else f" {value}")

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

    def show(self, blocks: Iterable[Block]) -> None:
        """A summary: tables under the last heading on stdout, notes on stderr."""
        from posefuse.foundation.summary import Facts, Heading, Note, Table

        title = ""
        for block in blocks:
            if isinstance(block, Heading):
                title = block.text
            elif isinstance(block, Note):
                (self.warn if block.warning else self.note)(block.text)
            elif isinstance(block, Facts):
                self._table(title, ("", ""), block.shown, header=False)
            elif isinstance(block, Table):
                shown = [[cell.value for cell in row] for row in block.shown]
                self._table(title, block.columns, shown, [block.is_number(i) for i in range(len(block.columns))])

    def _table(
        self,
        title: str,
        columns: Sequence[str],
        rows: Sequence[Sequence[str]],
        right: Sequence[bool] = (),
        *,
        header: bool = True,
    ) -> None:
        from rich.table import Table
        from rich.text import Text

        shown = Table(title=Text(title), title_justify="left", title_style="bold", header_style="", show_header=header)
        for i, column in enumerate(columns):
            shown.add_column(Text(column), justify="right" if i < len(right) and right[i] else "left", overflow="fold")
        for row in rows:
            # text as it is: square brackets in names of files are no markup
            shown.add_row(*(Text(in_options(text)) for text in row))
        widest = self._tables.measure(shown, options=self._tables.options.update(width=_ANY_WIDTH)).maximum
        if header and widest > self._tables.width:
            # narrow cells before broken words; the texts of facts may be broken
            shown.padding = (0, 0)
        self._tables.print(shown)

    def figures(self, figures: Mapping[str, Any]) -> None:
        """With --json: the one object on stdout."""
        from posefuse.foundation.parsing import plain

        if self._as_json:
            print(json.dumps(plain(figures), indent=2), flush=True)

    @contextmanager
    def stages(self) -> Iterator[Progress]:
        """What public functions report to: a bar on stderr per stage, and a line per message."""
        from posefuse.foundation.progress_bars import stage_bars

        with stage_bars(self._notes, self.note) as report:
            yield report
