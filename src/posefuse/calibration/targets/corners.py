"""What the cameras saw of a target: a flat table of corners."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array, frozen, frozen_fields
from posefuse.core.errors import choices

_DTYPES = {
    "camera": np.int64, "t_ns": np.int64, "patch": np.int64, "corner": np.int64, "xy_img": np.float64,
}  # fmt: skip


@dataclass(frozen=True, eq=False, kw_only=True)
class CornerObservations:
    """Corners of a target in the images of several cameras; one row per corner, sorted by camera, time, patch, corner.

    Attributes:
        cameras: names. sizes_wh: image size of each.
        frame_count: frames looked at per camera, with or without a target in them.
        camera: (N,) index into `cameras`. t_ns: (N,) time of the frame.
        patch: (N,) piece of the target (marker id; 0 for a board). corner: (N,) number of the corner on its patch.
        xy_img: (N, 2) raw px.
        doubled: (camera name, marker id, frames) of markers met twice in one image, whose corners were left out.
        edge_width_px: (camera name, px) usual width of moving edges in its images, with or without a target; NaN where
            nothing moved.
        recordings: (camera name, path) of the videos or folders of images, whose backgrounds are compared; may be empty.
    """

    cameras: tuple[str, ...]
    sizes_wh: tuple[tuple[int, int], ...]
    frame_count: tuple[int, ...]
    camera: Array
    t_ns: Array
    patch: Array
    corner: Array
    xy_img: Array
    doubled: tuple[tuple[str, int, int], ...] = field(default=())
    edge_width_px: tuple[tuple[str, float], ...] = field(default=())
    recordings: tuple[tuple[str, Path], ...] = field(default=())

    def __post_init__(self) -> None:
        frozen_fields(self, {name: "N 2" if name == "xy_img" else "N" for name in _DTYPES}, _DTYPES)
        order = np.lexsort((self.corner, self.patch, self.t_ns, self.camera))
        if (np.diff(order) < 0).any():
            for name, dtype in _DTYPES.items():
                object.__setattr__(self, name, frozen(getattr(self, name)[order], dtype, name))

    def __len__(self) -> int:
        return len(self.camera)

    def index(self, camera: str) -> int:
        """Place of a camera; raises InputError naming those that exist."""
        if camera not in self.cameras:
            raise InputError(f"observations: no camera {camera!r}; there are: {choices(self.cameras)}")
        return self.cameras.index(camera)

    def rows(self, keep: Array) -> CornerObservations:
        """The observations at the rows of a mask or index (cameras stay as they are)."""
        return replace(self, **{name: getattr(self, name)[keep] for name in _DTYPES})

    def of_camera(self, camera: str) -> CornerObservations:
        """What one camera saw, as observations of that camera alone."""
        i = self.index(camera)
        picked = self.rows(self.camera == i)
        return replace(
            picked,
            cameras=(camera,),
            sizes_wh=(self.sizes_wh[i],),
            frame_count=(self.frame_count[i],),
            camera=np.zeros(len(picked), np.int64),
            doubled=tuple(entry for entry in self.doubled if entry[0] == camera),
            edge_width_px=tuple(entry for entry in self.edge_width_px if entry[0] == camera),
        )

    def of_patches(self, patches: Iterable[int]) -> CornerObservations:
        """Only the corners of these patches."""
        return self.rows(np.isin(self.patch, list(patches)))

    def view_starts(self) -> Array:
        """(V,) first row of every run of rows that share camera, time and patch."""
        if len(self) == 0:
            return np.zeros(0, np.int64)
        keys = np.stack([self.camera, self.t_ns, self.patch])
        return np.flatnonzero(np.concatenate([[True], (np.diff(keys, axis=1) != 0).any(axis=0)]))


def joined(parts: Sequence[CornerObservations]) -> CornerObservations:
    """Observations of different cameras as one value; raises InputError when a camera comes twice."""
    names = tuple(name for part in parts for name in part.cameras)
    if len(set(names)) != len(names):
        raise InputError(f"observations: a camera comes twice among {choices(names)}")
    offsets = np.cumsum([0] + [len(part.cameras) for part in parts])
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(p, name) + (o if name == "camera" else 0) for p, o in zip(parts, offsets, strict=False)])
        for name in _DTYPES
    }
    return CornerObservations(
        cameras=names,
        sizes_wh=tuple(size for part in parts for size in part.sizes_wh),
        frame_count=tuple(count for part in parts for count in part.frame_count),
        doubled=tuple(entry for part in parts for entry in part.doubled),
        edge_width_px=tuple(entry for part in parts for entry in part.edge_width_px),
        **arrays,
    )
