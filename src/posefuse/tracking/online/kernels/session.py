"""What the kernels read: of a session, and of one view of one person."""

from __future__ import annotations

from typing import NamedTuple

from posefuse.core.arrays import Array


class Rules(NamedTuple):
    """What the kernels read of `LiveMotion` and `LiveSettings`, by its names there."""

    outlier_chi2: float
    gate_chi2: float
    switch_s: float
    lost_after_s: float
    new_share: float
    alone_hold_s: float
    measured_s: float
    lasting_share: float
    averaging: float
    bone_sigma_m: float


class SessionArrays(NamedTuple):
    """What is the same for all people and views: K keypoints, M motion models, C cameras, B bones.

    cameras: (C, 15) rotation, translation, centre. mirror: (K,) counterparts. group: (K,) the limbs a keypoint is exchanged with,
    -1 on the midline. neighbours: (K, n) keypoints at the other ends of its bones, -1 for none. ends: (B, 2) bones.
    models: (2, M, 2) acceleration of keypoints and of the body, and how long it lasts.
    """

    cameras: Array
    mirror: Array
    group: Array
    neighbours: Array
    ends: Array
    models: Array
    rules: Rules


class KeypointRays(NamedTuple):
    """One person in one view.

    camera: its number. z: (K, 2) ideal points, NaN where unseen. white: (K, 2, 2) turns their errors into sigmas.
    late_s: (K,) how long after mid-exposure a row was exposed. sigma_px: (K,) pixels per sigma.
    """

    camera: int
    z: Array
    white: Array
    late_s: Array
    sigma_px: Array
