"""Observations of free-running cameras brought to common time steps.

Between two frames of a camera a corner's image is interpolated by the cubic through its neighbours (Catmull and Rom 1974),
which also gives the image velocity that ties a camera's clock to the geometry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posefuse.calibration.targets.corners import CornerObservations
from posefuse.core.arrays import Array
from posefuse.core.view_sequences import nearest_frames

_SAME_S = 1e-4
# corners are interpolated over one lost frame, and never over more than this
_LONGEST_GAP_PERIODS, _LONGEST_GAP_S = 2.2, 0.4


@dataclass(frozen=True, eq=False, kw_only=True)
class Snapshots:
    """Corners at common time steps; rows sorted by time step, camera, patch, corner.

    Attributes:
        t_s: (T,) session time of the time steps, seconds since the middle of the recording.
        camera, time step, patch, corner: (N,) where a row belongs; `patch` counts in `patches`.
        xy_img: (N, 2) px. velocity_px_s: (N, 2); 0 where unknown. noise: (N,) how much noisier than usual a point is.
        patches: (M,) marker ids.
        group: (N,) rows of one patch in one image share a number. group_count: how many.
    """

    t_s: Array
    camera: Array
    time_step: Array
    patch: Array
    corner: Array
    xy_img: Array
    velocity_px_s: Array
    noise: Array
    patches: Array
    group: Array
    group_count: int

    def group_starts(self) -> Array:
        """(group_count,) first row of each group."""
        return np.flatnonzero(np.concatenate([[True], np.diff(self.group) != 0])) if len(self.group) else np.zeros(0, np.int64)

    def rows(self, keep: Array) -> Snapshots:
        """Only the rows of a mask; time steps and patches stay as they are."""
        return _grouped(self.t_s, self.patches, {name: getattr(self, name)[keep] for name in _COLUMNS})

    @classmethod
    def of_points(cls, t_s: Array, **columns: Array) -> Snapshots:
        """Rows of points that belong to no target: each is the one corner of a patch that is there at its own time step.

        Args:
            t_s: (P,) time of each point. columns: camera, time_step (which point), xy_img, velocity_px_s and noise of the rows.
        """
        none = np.zeros(len(columns["camera"]), np.int64)
        return _grouped(t_s, np.zeros(1, np.int64), {"patch": none, "corner": none, **columns})


_COLUMNS = ("camera", "time_step", "patch", "corner", "xy_img", "velocity_px_s", "noise")


def _grouped(t_s: Array, patches: Array, columns: Mapping[str, Array]) -> Snapshots:
    order = np.lexsort([columns[name] for name in ("corner", "patch", "camera", "time_step")])
    sorted_ = {name: column[order] for name, column in columns.items()}
    keys = np.stack([sorted_["time_step"], sorted_["camera"], sorted_["patch"]])
    group = np.cumsum(np.append(np.zeros(min(1, len(order))), (np.diff(keys, axis=1) != 0).any(axis=0))).astype(np.int64)
    return Snapshots(t_s=t_s, patches=patches, group=group, group_count=int(group[-1]) + 1 if len(group) else 0, **sorted_)


def middle_ns(observations: CornerObservations) -> int:
    """Middle of the recording: the zero of `Snapshots.t_s` and of clock drift."""
    return int((int(observations.t_ns.min()) + int(observations.t_ns.max())) // 2)


def snapshots(observations: CornerObservations, instants_ns: Array, delay_s: Array) -> Snapshots:
    """What each camera would have seen at `instants_ns` (T,).

    `delay_s` (C, 2): offset and drift of each camera's clock against the session's: a frame stamped s was taken at
    s - offset - drift * (s - middle). Corners without a frame close on both sides are left out.
    """
    zero = middle_ns(observations)
    t_s = (instants_ns - zero) / 1e9
    row_s = (observations.t_ns - zero) / 1e9
    patches, patch = np.unique(observations.patch, return_inverse=True)
    parts: list[tuple[Array, ...]] = []
    track = np.stack([observations.camera, patch, observations.corner])
    order = np.lexsort((row_s, track[2], track[1], track[0]))
    cuts = np.flatnonzero((np.diff(track[:, order], axis=1) != 0).any(axis=0)) + 1
    gaps_s = [_longest_gap_s(row_s[observations.camera == c]) for c in range(len(observations.cameras))]
    for rows in np.split(order, cuts) if len(order) else []:
        c = observations.camera[rows[0]]
        wanted_s = t_s + delay_s[c, 0] + delay_s[c, 1] * t_s
        found, xy, velocity = _at(row_s[rows], observations.xy_img[rows], wanted_s, gaps_s[c])
        n = len(found)
        place = (np.full(n, c), found, np.full(n, patch[rows[0]]), np.full(n, observations.corner[rows[0]]))
        parts.append((*place, xy, velocity, np.ones(n)))
    nothing = (*[np.zeros(0, np.int64)] * 4, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    columns = (np.concatenate(column) for column in zip(nothing, *parts, strict=True))
    return _grouped(t_s, patches, dict(zip(_COLUMNS, columns, strict=True)))


def _longest_gap_s(stamps_s: Array) -> float:
    steps = np.diff(np.unique(stamps_s))
    return min(_LONGEST_GAP_PERIODS * float(np.median(steps)), _LONGEST_GAP_S) if len(steps) else 0.0


def _at(track_s: Array, xy: Array, wanted_s: Array, longest_gap_s: float) -> tuple[Array, Array, Array]:
    """Which of the wanted times a track covers (n,), and place and velocity (n, 2) there."""
    last = len(track_s) - 1
    before = np.clip(np.searchsorted(track_s, wanted_s + _SAME_S, side="right") - 1, 0, last)
    after = np.minimum(before + 1, last)
    exact = np.abs(track_s[before] - wanted_s) <= _SAME_S
    gap = track_s[after] - track_s[before]
    between = (track_s[before] < wanted_s) & (wanted_s < track_s[after]) & (gap <= longest_gap_s)
    found = np.flatnonzero(exact | between)
    slopes = _slopes(track_s, xy, longest_gap_s)
    i, k = before[found], after[found]
    h = np.where(gap[found] > 0, gap[found], 1.0)[:, None]
    u = np.where(exact[found], 0.0, (wanted_s[found] - track_s[i]) / h[:, 0])[:, None]
    place = (
        (1 + 2 * u) * (1 - u) ** 2 * xy[i] + u * (1 - u) ** 2 * h * slopes[i]
        + u**2 * (3 - 2 * u) * xy[k] + u**2 * (u - 1) * h * slopes[k]
    )  # fmt: skip
    velocity = (
        6 * u * (u - 1) / h * (xy[i] - xy[k]) + (1 - u) * (1 - 3 * u) * slopes[i] + u * (3 * u - 2) * slopes[k]
    )  # fmt: skip
    return found, place, np.where(exact[found][:, None], slopes[i], velocity)


def _slopes(track_s: Array, xy: Array, longest_gap_s: float) -> Array:
    """Velocity (n, 2) at the frames of a track from their neighbours on both sides; one side where that is all there is."""
    if len(track_s) < 2:
        return np.zeros_like(xy)
    step = np.diff(track_s)
    near = ((step > 0) & (step <= longest_gap_s))[:, None]
    chord = np.where(near, np.diff(xy, axis=0) / np.where(near, step[:, None], 1.0), 0.0)
    left, right = np.vstack([[[0, 0]], chord]), np.vstack([chord, [[0, 0]]])
    has_left, has_right = np.vstack([[[False]], near]), np.vstack([near, [[False]]])
    gap_left, gap_right = np.append([0.0], step)[:, None], np.append(step, [0.0])[:, None]
    total = np.maximum(gap_left + gap_right, 1e-12)
    slope = np.where(has_left & has_right, (left * gap_right + right * gap_left) / total, left + right)
    # the parabola through three frames has 2 * chord - slope at one end of a chord if it has that slope at the other end
    inner = has_left & has_right
    first, final = has_right & ~has_left, has_left & ~has_right
    slope[:-1] = np.where(first[:-1] & inner[1:], 2 * chord - slope[1:], slope[:-1])
    slope[1:] = np.where(final[1:] & inner[:-1], 2 * chord - slope[:-1], slope[1:])
    return np.asarray(slope)


def evenly(items: Array, most: int) -> Array:
    """So many of the items at most, evenly over all of them."""
    return np.asarray(items[np.unique(np.linspace(0, len(items) - 1, min(len(items), most)).astype(np.int64))])


def evenly_shared(present: Array, most: int, least: int) -> Array:
    """Indices of time steps (T,) at which two cameras or more are present (T, C): `most` of them, evenly over all.

    A camera that is seldom there needs more than its share: it gets `least`, where it has so many.
    """
    several = np.flatnonzero(present.sum(axis=1) >= 2)
    chosen = evenly(several, most)
    for mine in present.T:
        if mine[chosen].sum() < least:
            chosen = np.union1d(chosen, evenly(several[mine[several]], least))
    return chosen


def pick_time_steps(observations: CornerObservations, most: int, delay_s: Array) -> Array:
    """About `most` times (T,) ns, spread over the recording; at least 2 cameras each, and a quarter of them with each camera."""
    counts = np.bincount(observations.camera, minlength=len(observations.cameras))
    reference = int(np.argmax(counts))
    candidates = np.unique(observations.t_ns[observations.camera == reference])
    others = np.unique(observations.t_ns[observations.camera != reference])
    if len(candidates) > 1:
        # times at which the busiest camera saw nothing
        distance = np.abs(others - candidates[nearest_frames(candidates, others)])
        candidates = np.unique(np.concatenate([candidates, others[distance > np.median(np.diff(candidates))]]))
    candidates = candidates[:: max(1, len(candidates) // (6 * most))]
    seen = snapshots(observations, candidates, delay_s)
    present = np.zeros((len(candidates), len(counts)), bool)
    present[seen.time_step, seen.camera] = True
    return candidates[evenly_shared(present, most, most // 4)]
