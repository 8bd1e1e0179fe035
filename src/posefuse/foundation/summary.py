"""What a result states about itself, as blocks in reading order: the terminal, a page and the studio show the same ones."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar, Literal, Protocol

from posefuse.core import InputError

MISSING = "–"
# what is smaller is a rounding error
_MOST_DIGITS = 9
Tone = Literal["", "left", "right", "mid", "good", "bad"]


class Block(Protocol):
    """A part of a summary or page; `kind` names what shows it: the macro of a page, the method of a terminal."""

    kind: ClassVar[str]


@dataclass(frozen=True)
class Heading:
    """A heading, and a paragraph under it."""

    text: str
    note: str = ""
    _: KW_ONLY
    level: Literal[2, 3] = 2
    kind: ClassVar[str] = "heading"


@dataclass(frozen=True)
class Note:
    """A paragraph; a warning stands out."""

    text: str
    _: KW_ONLY
    warning: bool = False
    kind: ClassVar[str] = "note"


@dataclass(frozen=True)
class Facts:
    """Names and values, one per line."""

    values: Mapping[str, Any]
    kind: ClassVar[str] = "facts"

    @property
    def shown(self) -> list[tuple[str, str]]:
        """Names and texts."""
        return [(name, column_texts([value])[0]) for name, value in self.values.items()]


@dataclass(frozen=True)
class Cell:
    """A cell of a table with a colour: that of a side of the body, or good or bad."""

    value: Any
    tone: Tone = ""


@dataclass(frozen=True)
class Table:
    """Rows under named columns; the first column is text, the others are numbers unless listed in `text`.

    Attributes:
        rows: cells as plain values or `Cell`; floats are shown with one number of digits per column, NaN and None as a dash.
        text: every column is text, aligned to the left.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    _: KW_ONLY
    text: bool = False
    kind: ClassVar[str] = "table"

    def __post_init__(self) -> None:
        wrong = [len(row) for row in self.rows if len(row) != len(self.columns)]
        if wrong:
            raise InputError(f"table: expected rows of {len(self.columns)} cells ({', '.join(self.columns)}), got {wrong[0]}")

    def is_number(self, column: int) -> bool:
        """Whether every cell of a column is a number or missing."""
        values = [row[column].value if isinstance(row[column], Cell) else row[column] for row in self.rows]
        return all(value is None or isinstance(value, numbers.Real) for value in values)

    @property
    def shown(self) -> list[list[Cell]]:
        """Every cell as a `Cell` with its text."""
        cells = [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in self.rows]
        columns = [
            [Cell(text, cell.tone) for text, cell in zip(column_texts([c.value for c in column]), column, strict=True)]
            for column in zip(*cells, strict=True)
        ]
        return [list(row) for row in zip(*columns, strict=True)]


def column_texts(values: Sequence[Any]) -> list[str]:
    """Floats with one number of digits after the point: three significant ones of the largest, but no needless zeros."""
    known = [float(value) for value in values if _is_float(value) and math.isfinite(value)]
    largest = max(map(abs, known), default=0.0)
    digits = min(max(1, 2 - math.floor(math.log10(largest))), _MOST_DIGITS) if largest else 1
    while digits > 1 and all(f"{value:.{digits}f}".endswith("0") for value in known):
        digits -= 1
    return [_text(value, digits) for value in values]


def number_text(value: float, digits: int) -> str:
    """A number with so many digits after the point; a dash where it is not finite."""
    return f"{value:.{digits}f}" if math.isfinite(value) else MISSING


def _text(value: Any, digits: int) -> str:
    if value is None or (_is_float(value) and not math.isfinite(value)):
        return MISSING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if _is_float(value):
        return f"{value:z,.{digits}f}"
    return f"{value:,}" if isinstance(value, numbers.Integral) else str(value)


def _is_float(value: Any) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, numbers.Integral)
