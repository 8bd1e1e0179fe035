"""Numbers of a page, as finely as a screen shows them."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array

# parts of the range of the values: finer than a screen shows, and coarse enough that noise is not stored
FINE, COARSE = 10_000, 2_000


def page_numbers(values: Array, parts: int) -> list[float | None]:
    """Values (n,) rounded to a power of ten that is at most 1 / `parts` of their range; what is not finite becomes null."""
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if len(known) else 0.0
    span = span or (float(np.abs(known).max()) if len(known) else 0.0) or 1.0
    return with_decimals(values, int(min(12, np.ceil(np.log10(parts) - np.log10(span)))))


def with_decimals(values: Array, decimals: int) -> list[float | None]:
    """Values (n,) with so many decimals; what is not finite becomes null."""
    return [value if np.isfinite(value) else None for value in np.round(values, decimals).tolist()]


class Arrays:
    """Arrays of a page, each stored once; series name them by their number."""

    def __init__(self) -> None:
        self.content: list[list[float | None]] = []
        self._known: dict[tuple[bytes, int], int] = {}

    def add(self, values: Array, parts: int = FINE) -> int:
        """The number of an array (n,), kept to 1 / `parts` of its range."""
        values = np.ascontiguousarray(values, float)
        key = values.tobytes(), parts
        if key not in self._known:
            self._known[key] = len(self.content)
            self.content.append(page_numbers(values, parts))
        return self._known[key]
