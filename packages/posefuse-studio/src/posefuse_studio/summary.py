"""The blocks of a summary as elements of a page: what a result states about itself, as on the terminal and in a report."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from nicegui import ui

from posefuse.foundation.summary import Block, Cell, Facts, Heading, Note, Table

from .shell import light, small


def show_summary(blocks: Iterable[Block]) -> None:
    """Place them."""
    for block in blocks:
        match block:
            case Heading():
                ui.label(block.text).classes("pf-h2")
                if block.note:
                    small(block.note)
            case Note():
                light("doubt", block.text) if block.warning else small(block.text)
            case Facts():
                _grid([(Cell(name), Cell(value)) for name, value in block.shown])
            case Table():
                _grid([[Cell(name) for name in block.columns], *block.shown])


def _grid(rows: Sequence[Sequence[Cell]]) -> None:
    columns = f"repeat({max(map(len, rows), default=1) - 1}, auto) 1fr"
    with ui.element("div").classes("pf-summary").style(f"grid-template-columns: {columns}"):
        for row in rows:
            for cell in row:
                small(str(cell.value)).classes(f"pf-tone-{cell.tone or 'none'}")
