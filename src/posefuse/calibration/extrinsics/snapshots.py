"""Observations of free-running cameras brought to common time steps.

Between two frames of a camera a corner's image is interpolated (`clocks.paths.between_frames`), which also gives the image
velocity that ties a camera's clock to the geometry.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posefuse.calibration.clocks.paths import LONGEST_GAP_PERIODS, between_frames
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.core.arrays import Array
from posefuse.core.view_sequences import nearest_frames

# corners are interpolated over one lost frame, and never over more than this
_LONGEST_GAP_S = 0.4
_SLOW_PX_S = 150.0


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
        xy, velocity = between_frames(row_s[rows], observations.xy_img[rows], wanted_s, gaps_s[c])
        found = np.flatnonzero(np.isfinite(xy[:, 0]))
        n = len(found)
        place = (np.full(n, c), found, np.full(n, patch[rows[0]]), np.full(n, observations.corner[rows[0]]))
        parts.append((*place, xy[found], velocity[found], np.ones(n)))
    nothing = (*[np.zeros(0, np.int64)] * 4, np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    columns = (np.concatenate(column) for column in zip(nothing, *parts, strict=True))
    return _grouped(t_s, patches, dict(zip(_COLUMNS, columns, strict=True)))


def _longest_gap_s(stamps_s: Array) -> float:
    steps = np.diff(np.unique(stamps_s))
    return min(LONGEST_GAP_PERIODS * float(np.median(steps)), _LONGEST_GAP_S) if len(steps) else 0.0


def evenly(items: Array, most: int) -> Array:
    """So many of the items at most, evenly over all of them."""
    return np.asarray(items[np.unique(np.linspace(0, len(items) - 1, min(len(items), most)).astype(np.int64))])


def pick_time_steps(observations: CornerObservations, most: int, delay_s: Array, prefer_slow: bool) -> Array:
    """At most `most` times (T,) ns, spread over the images, the camera pairs and the recording; at least 2 cameras each."""
    counts = np.bincount(observations.camera, minlength=len(observations.cameras))
    reference = int(np.argmax(counts))
    candidates = np.unique(observations.t_ns[observations.camera == reference])
    others = np.unique(observations.t_ns[observations.camera != reference])
    if len(candidates) > 1:
        # times at which the busiest camera saw nothing
        distance = np.abs(others - candidates[nearest_frames(candidates, others)])
        candidates = np.unique(np.concatenate([candidates, others[distance > np.median(np.diff(candidates))]]))
    thin = max(1, len(candidates) // (6 * most))
    return _greedy(observations, candidates[::thin], most, delay_s, prefer_slow)


def _greedy(observations: CornerObservations, candidates: Array, most: int, delay_s: Array, prefer_slow: bool) -> Array:
    seen = snapshots(observations, candidates, delay_s)
    cameras, time_steps = len(observations.cameras), len(candidates)
    pair = seen.time_step * cameras + seen.camera
    corners = np.bincount(pair, minlength=time_steps * cameras).reshape(time_steps, cameras)
    present = corners > 0
    total = np.stack([np.bincount(pair, seen.xy_img[:, k], time_steps * cameras) for k in (0, 1)], axis=-1)
    centre = total.reshape(time_steps, cameras, 2) / np.maximum(corners, 1)[..., None]
    share = centre / np.array(observations.sizes_wh, np.float64)
    cell = np.clip((share * 4).astype(np.int64), 0, 3) @ np.array([4, 1])
    speed = np.bincount(seen.time_step, np.linalg.norm(seen.velocity_px_s, axis=1), time_steps) / np.maximum(
        corners.sum(axis=1), 1
    )
    worth = (corners.sum(axis=1) / np.maximum(present.sum(axis=1), 1)) ** 0.5
    if prefer_slow:
        worth = worth / (1 + speed / _SLOW_PX_S)
    return candidates[_take(present, cell, worth, most)]


def _take(present: Array, cell: Array, worth: Array, most: int) -> Array:
    """Indices of time steps, each the one that adds most where little has been seen so far.

    Every n-th instead refuses a camera of which every third time stamp is wrong (`tests/calibration/test_between_frames.py`).
    """
    time_steps, cameras = present.shape
    both = present[:, :, None] & present[:, None, :]
    cell_count, pair_count = np.zeros((cameras, 16)), np.zeros((cameras, cameras))
    time_count = np.zeros(16)
    section = np.arange(time_steps) * 16 // max(time_steps, 1)
    possible = present.sum(axis=1) >= 2
    taken: list[int] = []
    columns = np.arange(cameras)
    while len(taken) < most and possible.any():
        gain = (present / (1 + cell_count[columns, cell])).sum(axis=1) + (both / (1 + pair_count)).sum(axis=(1, 2)) / 2
        best = int(np.argmax(np.where(possible, gain * worth / (1 + time_count[section]) ** 0.5, -1.0)))
        taken.append(best)
        possible[best] = False
        np.add.at(cell_count, (columns[present[best]], cell[best, present[best]]), 1)
        pair_count += both[best]
        time_count[section[best]] += 1
    return np.array(sorted(taken), dtype=np.int64)
