"""Numbers of a page as short JSON: decimal integers, each the difference from the one before."""

from __future__ import annotations

from typing import Any

import numpy as np

from posefuse.core.arrays import Array

# of the range of the values: finer than any plot can be zoomed into
_STEPS = 50_000.0
_LEAST_DECIMALS, _MOST_DECIMALS = -6, 12


def decimals_for(values: Array) -> int:
    """Digits after the point that keep every value to 1 / 50,000 of the range of all."""
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if len(known) else 0.0
    span = span or (float(np.abs(known).max()) if len(known) else 0.0) or 1.0
    return int(np.clip(np.ceil(np.log10(_STEPS / span)), _LEAST_DECIMALS, _MOST_DECIMALS))


def packed(values: Array, decimals: int | None = None) -> dict[str, Any]:
    """``{"n": decimals, "d": differences}`` of values (n,); what is not finite becomes null. Undone by `unpacked`."""
    values = np.asarray(values, float).ravel()
    n = decimals_for(values) if decimals is None else decimals
    known = np.isfinite(values)
    whole = np.round(values[known] * 10.0**n).astype(np.int64)
    steps: list[int | None] = [None] * len(values)
    for place, step in zip(np.flatnonzero(known).tolist(), np.diff(whole, prepend=0).tolist(), strict=True):
        steps[place] = step
    return {"n": n, "d": steps}


def unpacked(content: dict[str, Any]) -> Array:
    """Values (n,) of what `packed` gives; NaN where it has null."""
    known = np.array([step is not None for step in content["d"]], bool)
    values = np.full(len(known), np.nan)
    values[known] = np.cumsum([step for step in content["d"] if step is not None]) / 10.0 ** content["n"]
    return values


class PackedArrays:
    """Arrays of a page, each stored once; series name them by their number."""

    def __init__(self) -> None:
        self.content: list[dict[str, Any]] = []
        self._known: dict[bytes, int] = {}

    def add(self, values: Array) -> int:
        """The number of an array (n,)."""
        values = np.ascontiguousarray(values, float)
        key = values.tobytes()
        if key not in self._known:
            self._known[key] = len(self.content)
            self.content.append(packed(values))
        return self._known[key]
