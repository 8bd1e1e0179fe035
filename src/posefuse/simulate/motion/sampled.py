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
from posefuse.simulate.body import SEGMENTS, Body

from .posture import Posture, bones_of

_SOLE_M = 0.05
_SOFT_S = 0.12
_TOUCHING_PERCENT = 10.0


@dataclass(frozen=True, eq=False)
class Sampled:
    """A recorded motion.

    Attributes:
        t_s: (n,) increasing, n >= 2. centre_world: (n, 3). axes_world: segment -> (n, 3, 3).
        start_s: its time shown at time 0. loop: begin anew after the end; otherwise the first and last pose stay.
    """

    t_s: Array
    centre_world: Array
    axes_world: Mapping[str, Array]
    start_s: float
    loop: bool

    def posture(self, t_s: Array) -> Posture:
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
        return Posture(CubicSpline(self.t_s, self.centre_world)(at), axes, np.zeros((len(t_s), 2)))


def on_floor(body: Body, motion: Sampled, floor_known: bool) -> Sampled:
    """The motion raised smoothly wherever a foot would be below the floor.

    Without a known floor the whole motion is first shifted so that the lowest feet, most of the time, just touch it.
    """
    low = lowest_foot_m(body, Posture(motion.centre_world, motion.axes_world, np.zeros((len(motion.t_s), 2))))
    shift = 0.0 if floor_known else -float(np.percentile(low, _TOUCHING_PERCENT))
    step_s = float(np.median(np.diff(motion.t_s)))
    reach = max(1, round(_SOFT_S / step_s))
    need = maximum_filter1d(np.maximum(-(low + shift), 0.0), 4 * reach + 1, mode="nearest")
    raised = gaussian_filter1d(need, reach / 2, mode="nearest", truncate=4.0)
    return replace(motion, centre_world=motion.centre_world + np.outer(raised + shift, [0.0, 0.0, 1.0]))


def lowest_foot_m(body: Body, posture: Posture) -> Array:
    """Height (T,) of the lowest point of both soles."""
    bones = bones_of(body, posture)
    pose = body.segments(bones)
    lowest = []
    for side, letter in (("left", "L"), ("right", "R")):
        place = SEGMENTS.index(f"{side}_foot")
        points = (_sole_points(body, letter) - body.segment_origin[place]) @ body.segment_axes[place]
        heights = pose.matrix()[:, place, 2] @ points.T + pose.xyz[:, place, 2:]
        lowest.append(heights.min(axis=1))
    return np.minimum(*lowest)


def _sole_points(body: Body, letter: str) -> Array:
    """(n, 3) corners at rest of the lower part of a foot, toes included."""
    bones = [b for b, name in enumerate(body.bone_names) if name.startswith(("foot", "toe")) and name.endswith(f".{letter}")]
    share = np.where(np.isin(body.bone_index, bones), body.bone_weight, 0.0).sum(axis=1)
    points = body.vertices_rest[share > 0.5]
    points = points[points[:, 2] < points[:, 2].min() + _SOLE_M]
    return points[ConvexHull(points).vertices]
