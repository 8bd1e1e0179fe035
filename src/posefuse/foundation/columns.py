"""Values of one column of a table as text."""

from __future__ import annotations

import math
import numbers
from collections.abc import Sequence
from typing import Any


def column_texts(values: Sequence[Any], missing: str) -> list[str]:
    """Floats with one number of digits after the point: three significant ones of the largest, but no needless zeros."""
    known = [float(value) for value in values if _is_float(value) and math.isfinite(value)]
    largest = max(map(abs, known), default=0.0)
    digits = max(1, 2 - math.floor(math.log10(largest))) if largest else 1
    while digits > 1 and all(f"{value:.{digits}f}".endswith("0") for value in known):
        digits -= 1
    return [_text(value, digits, missing) for value in values]


def _text(value: Any, digits: int, missing: str) -> str:
    if value is None or (_is_float(value) and not math.isfinite(value)):
        return missing
    if isinstance(value, bool):
        return "yes" if value else "no"
    if _is_float(value):
        return f"{value:,.{digits}f}"
    return f"{value:,}" if isinstance(value, numbers.Integral) else str(value)


def _is_float(value: Any) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, numbers.Integral)
