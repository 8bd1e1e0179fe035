"""Several calibrated cameras in one world frame."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np

from .arrays import Array
from .camera import Camera
from .errors import CalibrationError, choices
from .se3 import SE3


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras in a fixed order, which is axis C of every array that has one.

    Attributes:
        cameras: at least one, names unique.
        world_set_by: how the world frame came about, in words (``"marker system"``, ``"simulated"``, ``"unknown"``).
        residual_px: rms reprojection error of the calibration; NaN when unknown.
        refused: the checks that this calibration failed, when it was kept all the same; empty for one to be trusted.

    Raises:
        CalibrationError: no camera, or two of one name.
    """

    cameras: tuple[Camera, ...]
    world_set_by: str = "unknown"
    residual_px: float = float("nan")
    refused: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "cameras", tuple(self.cameras))
        if not self.cameras:
            raise CalibrationError("rig: expected at least 1 camera, got 0")
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise CalibrationError(f"rig: camera names must be unique, got twice: {choices(twice)}")

    def __repr__(self) -> str:
        return f"Rig({len(self)} cameras: {', '.join(self.names)}; id {self.id}; world set by {self.world_set_by})"

    def __len__(self) -> int:
        return len(self.cameras)

    def __iter__(self) -> Iterator[Camera]:
        return iter(self.cameras)

    def __getitem__(self, name: str) -> Camera:
        for camera in self.cameras:
            if camera.name == name:
                return camera
        raise CalibrationError(f"rig: no camera {name!r}; there are: {choices(self.names)}")

    @property
    def names(self) -> tuple[str, ...]:
        """Camera names in the order of axis C."""
        return tuple(camera.name for camera in self.cameras)

    @property
    def id(self) -> str:
        """12 hex digits over all that changes a projection: equal rigs have equal ids on every machine."""
        digest = hashlib.sha256()
        for camera in self.cameras:
            # trailing zeros bend nothing in a pinhole lens, and some file formats write five places always
            lens = np.trim_zeros(camera.distortion, "b") if camera.model == "pinhole" else camera.distortion
            numbers = np.concatenate(
                [
                    np.asarray(camera.size_wh, np.float64),
                    camera.K.ravel(),
                    lens,
                    camera.cam_from_world.matrix().ravel(),
                    camera.cam_from_world.xyz,
                    [camera.readout_s],
                ]
            )
            # rounded, so that a file written and read back keeps its id
            text = " ".join(f"{number + 0.0:.6g}" for number in np.round(numbers, 9) + 0.0)
            digest.update(f"{camera.name}|{camera.model}|{text}\n".encode())
        return digest.hexdigest()[:12]

    def projections(self) -> Array:
        """(C, 3, 4) projection matrices from world metres to undistorted px."""
        return np.stack([camera.projection() for camera in self.cameras])

    def centres_world(self) -> Array:
        """(C, 3) optical centres in world metres."""
        return np.stack([camera.centre_world for camera in self.cameras])

    def project(self, xyz_world: Array) -> Array:
        """Raw pixels (C, ..., 2) of world points (..., 3)."""
        return np.stack([camera.project(xyz_world) for camera in self.cameras])

    def only(self, names: Iterable[str]) -> Self:
        """The rig of these cameras, in this order; raises CalibrationError for a name that is not there."""
        return replace(self, cameras=tuple(self[name] for name in names))

    def renamed(self, names: Mapping[str, str]) -> Self:
        """The rig with cameras renamed old -> new; those not mentioned keep their name."""
        return replace(self, cameras=tuple(replace(c, name=names.get(c.name, c.name)) for c in self.cameras))

    def moved(self, new_from_old: SE3) -> Self:
        """The same cameras described in another world frame."""
        back = new_from_old.inverse()
        return replace(self, cameras=tuple(replace(c, cam_from_world=c.cam_from_world @ back) for c in self.cameras))


@lru_cache(maxsize=32)
def packed_rig(rig: Rig) -> Array:
    """(C, 15) float64, as kernels read cameras; the same array for the same rig, so do not write to it.

    Rotation and translation of `cam_from_world` row by row (12 columns), then the optical centre in the world.
    """
    return np.stack([np.append(c.cam_from_world.matrix4()[:3], c.centre_world) for c in rig])
