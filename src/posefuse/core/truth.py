"""What is known exactly: the truth of a simulated scene. Axes as in `values`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import Array, FrozenArrays, frozen_fields
from .errors import ShapeError
from .joint_angles import JointAngles
from .rig import Rig
from .skeleton import Skeleton
from .values import check_keypoints


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraTruth(FrozenArrays):
    """What one camera would have seen exactly, at its own frame times.

    Attributes:
        t_ns: (F,) mid-exposure, session clock, strictly increasing.
        xy_img: (F, N, K, 2) raw distorted px; NaN behind the camera.
        visible: (F, N, K) bool: in the image and not hidden, by depth test.
    """

    camera: str
    t_ns: Array
    xy_img: Array
    visible: Array

    def __post_init__(self) -> None:
        frozen_fields(self, {"t_ns": "F", "xy_img": "F N K 2", "visible": "F N K"}, {"visible": np.bool_})


@dataclass(frozen=True, eq=False, kw_only=True)
class Truth(FrozenArrays):
    """A scene known exactly.

    Attributes:
        rig: the true cameras.
        t_ns: (T,) session clock.
        skeleton: anatomical keypoints. person_id: (N,).
        xyz_world: (T, N, K, 3).
        joints: segment poses and angles at the same times, from the body model itself; None when not asked for.
        views: one entry per camera, in the order of the rig.
    """

    rig: Rig
    t_ns: Array
    skeleton: Skeleton
    person_id: Array
    xyz_world: Array
    views: tuple[CameraTruth, ...]
    joints: JointAngles | None = None

    def __post_init__(self) -> None:
        sizes = frozen_fields(self, {"t_ns": "T", "person_id": "N", "xyz_world": "T N K 3"})
        check_keypoints(self, sizes)
        if tuple(view.camera for view in self.views) != self.rig.names:
            raise ShapeError("Truth.views: expected one entry per camera of the rig, in its order")
        if any(view.visible.shape[1:] != (sizes["N"], sizes["K"]) for view in self.views):
            raise ShapeError(f"Truth.views: expected {sizes['N']} people and {sizes['K']} keypoints in every view")
