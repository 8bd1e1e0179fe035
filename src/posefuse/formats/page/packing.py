"""Numbers of a page as short JSON: whole steps, each the difference from the one before."""

from __future__ import annotations

from typing import Any

import numpy as np

from posefuse.core.arrays import Array

# of the range of the values: finer than a screen shows, and coarse enough that noise is not stored
FINE, COARSE = 10_000, 2_000
_LEAST_DECIMALS, _MOST_DECIMALS = -6, 12
_FACTORS = (5, 2, 1)


def step_for(values: Array, parts: int = FINE) -> tuple[int, int]:
    """(m, n) of the largest step m / 10^n, m one of 1, 2, 5, that is at most 1 / `parts` of the range of the values."""
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if len(known) else 0.0
    span = span or (float(np.abs(known).max()) if len(known) else 0.0) or 1.0
    decimals = int(np.clip(np.ceil(np.log10(parts / span)), _LEAST_DECIMALS, _MOST_DECIMALS))
    return next((factor for factor in _FACTORS if factor * 10.0**-decimals <= span / parts), 1), decimals


def packed(values: Array, parts: int = FINE, step: tuple[int, int] | None = None) -> dict[str, Any]:
    """``{"m": m, "n": n, "d": differences}`` in steps of m / 10^n of values (n,); what is not finite becomes null.

    Undone by `unpacked` to half a step, which is `step` or the one that `step_for` finds.
    """
    values = np.asarray(values, float).ravel()
    m, n = step or step_for(values, parts)
    known = np.isfinite(values)
    whole = np.round(values[known] * 10.0**n / m).astype(np.int64)
    steps: list[int | None] = [None] * len(values)
    for place, difference in zip(np.flatnonzero(known).tolist(), np.diff(whole, prepend=0).tolist(), strict=True):
        steps[place] = difference
    return {"m": m, "n": n, "d": steps}


def unpacked(content: dict[str, Any]) -> Array:
    """Values (n,) of what `packed` gives; NaN where it has null."""
    known = np.array([step is not None for step in content["d"]], bool)
    values = np.full(len(known), np.nan)
    values[known] = np.cumsum([step for step in content["d"] if step is not None]) * content["m"] / 10.0 ** content["n"]
    return values


class PackedArrays:
    """Arrays of a page, each stored once; series name them by their number."""

    def __init__(self) -> None:
        self.content: list[dict[str, Any]] = []
        self._known: dict[tuple[bytes, int], int] = {}

    def add(self, values: Array, parts: int = FINE) -> int:
        """The number of an array (n,), kept to 1 / `parts` of its range."""
        values = np.ascontiguousarray(values, float)
        key = values.tobytes(), parts
        if key not in self._known:
            self._known[key] = len(self.content)
            self.content.append(packed(values, parts))
        return self._known[key]
