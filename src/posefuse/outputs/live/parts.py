"""Names of files that an output continues in after a failure."""

from __future__ import annotations

import itertools
from pathlib import Path


def part_path(path: Path, part: int) -> Path:
    """`path` for part 1; later ones get a number before the suffix (``NAME.2.mcap``), one no file has yet."""
    if part == 1:
        return path
    numbered = (path.with_name(f"{path.stem}.{number}{path.suffix}") for number in itertools.count(part))
    return next(name for name in numbered if not name.exists())
