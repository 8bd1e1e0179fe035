"""Recorded motions: postures at given times, shown at any time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from posefuse.core.arrays import Array
from posefuse.simulation.body import SEGMENTS, SimulatedBody

from .posture import BodyPosture, bones_of

_SOLE_M = 0.05
_SOFT_S = 0.12
_TOUCHING_PERCENT = 10.0
_BALL_ON_FLOOR_M = 0.045
_TOES_UP_MOST_RAD = np.deg2rad(65.0)
_SIDES = {"left": "L", "right": "R"}


@dataclass(frozen=True, eq=False, kw_only=True)
class Sampled:
    """A recorded motion.

    Attributes:
        t_s: (n,) increasing, n >= 2. centre_world: (n, 3). axes_world: segment -> (n, 3, 3). toes_up_rad: (n, 2).
        start_s: its time shown at time 0. loop: start again after the end; otherwise the first and last pose stay.
    """

    t_s: Array
    centre_world: Array
    axes_world: Mapping[str, Array]
    toes_up_rad: Array
    start_s: float
    loop: bool

    def posture(self, t_s: Array) -> BodyPosture:
        """Postures at times (T,): rotations along the shortest turn, the pelvis along a cubic spline."""
        first, last = self.t_s[0], self.t_s[-1]
        at = t_s + self.start_s + first
        at = first + np.mod(at - first, last - first) if self.loop else np.clip(at, first, last)
        i = np.clip(np.searchsorted(self.t_s, at, side="right") - 1, 0, len(self.t_s) - 2)
        part = ((at - self.t_s[i]) / (self.t_s[i + 1] - self.t_s[i]))[:, None]
        axes = {}
        for name, turns in self.axes_world.items():
            step = Rotation.from_matrix(np.swapaxes(turns[i], -1, -2) @ turns[i + 1]).as_rotvec()
            axes[name] = turns[i] @ Rotation.from_rotvec(part * step).as_matrix()
        toes = self.toes_up_rad[i] + part * (self.toes_up_rad[i + 1] - self.toes_up_rad[i])
        return BodyPosture(CubicSpline(self.t_s, self.centre_world)(at), axes, toes)


def on_floor(body: SimulatedBody, motion: Sampled, floor_known: bool) -> Sampled:
    """The motion raised smoothly wherever a foot would be below the floor, with toes that lie flat under a raised heel.

    Without a known floor the whole motion is first shifted so that the lowest feet, most of the time, just touch it.
    """
    low, balls = _foot_heights_m(body, motion)
    shift = 0.0 if floor_known else -float(np.percentile(low.min(axis=1), _TOUCHING_PERCENT))
    step_s = float(np.median(np.diff(motion.t_s)))
    reach = max(1, round(_SOFT_S / step_s))
    need = maximum_filter1d(np.maximum(-(low.min(axis=1) + shift), 0.0), 4 * reach + 1, mode="nearest")
    rise = gaussian_filter1d(need, reach / 2, mode="nearest", truncate=4.0) + shift
    near = np.clip(1 - (balls + rise[:, None] - _BALL_ON_FLOOR_M) / _BALL_ON_FLOOR_M, 0.0, 1.0)
    pitch = np.stack([np.arcsin(np.clip(motion.axes_world[f"{side}_foot"][:, 2, 0], -1, 1)) for side in _SIDES], axis=-1)
    toes = near * np.clip(-pitch, 0.0, _TOES_UP_MOST_RAD)
    return replace(motion, centre_world=motion.centre_world + np.outer(rise, [0.0, 0.0, 1.0]), toes_up_rad=toes)


def _foot_heights_m(body: SimulatedBody, motion: Sampled) -> tuple[Array, Array]:
    """Heights (n, 2), left and right, of the lowest point of the foot without its toes, and of the toe joints."""
    bones = bones_of(body, BodyPosture(motion.centre_world, motion.axes_world, motion.toes_up_rad))
    pose = body.segments(bones)
    lowest, balls = [], []
    for side, letter in _SIDES.items():
        place = SEGMENTS.index(f"{side}_foot")
        ball = np.mean([body.bone_centre[body.bone(f"toe{i}-1.{letter}")] for i in (1, 2)], axis=0)
        points = np.vstack([_sole_points(body, letter), ball])
        local = (points - body.segment_origin[place]) @ body.segment_axes[place]
        heights = pose.matrix()[:, place, 2] @ local.T + pose.xyz[:, place, 2:]
        lowest.append(heights[:, :-1].min(axis=1))
        balls.append(heights[:, -1])
    return np.stack(lowest, axis=-1), np.stack(balls, axis=-1)


def _sole_points(body: SimulatedBody, letter: str) -> Array:
    """(n, 3) corners at rest of the lower part of a foot without its toes."""
    share = np.where(body.bone_index == body.bone(f"foot.{letter}"), body.bone_weight, 0.0).sum(axis=1)
    points = body.vertices_rest[share > 0.5]
    points = points[points[:, 2] < points[:, 2].min() + _SOLE_M]
    return np.asarray(points[ConvexHull(points).vertices])
