"""Named points of one person over time: what files of other systems hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import ShapeError
from posefuse.core.arrays import Array, check_fields, freeze_fields


@dataclass(frozen=True, eq=False, kw_only=True)
class NamedPoints:
    """Named points over time.

    Attributes:
        names: K points. t_s: (T,) seconds as in the file. xyz_world: (T, K, 3) metres, Z up; NaN where missing.
    """

    names: tuple[str, ...]
    t_s: Array
    xyz_world: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        freeze_fields(self, dict.fromkeys(("t_s", "xyz_world"), np.float64))
        sizes = check_fields(self, {"t_s": "T", "xyz_world": "T K 3"})
        if sizes["K"] != len(self.names):
            raise ShapeError(f"{type(self).__name__}: {len(self.names)} names for {sizes['K']} points")
