"""One person in all cameras at common time steps; and which one, where cameras see several: whom most cameras see together.

People are followed in each camera by themselves first. Of two cameras' people those are the same whose keypoints lie on each
other's epipolar lines (the essential matrix that most of them agree on, by consensus), whatever clothes they wear.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from posefuse.calibration.clocks.paths import at_times
from posefuse.calibration.clocks.person_tracks import PersonTrack, person_tracks
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.core import Camera, Detections2D, Skeleton
from posefuse.core.arrays import Array, frozen_fields
from posefuse.core.duplicate_share import DUPLICATE_SHARE
from posefuse.core.duplicates import bodies_apart, duplicates

_LEAST_SCORE = 0.35


@dataclass(frozen=True, eq=False)
class PersonViews:
    """One person in all cameras.

    Attributes:
        cameras: names. skeleton: names axis K. t_ns: (T,).
        xy_img: (C, T, K, 2) raw px, NaN where missing. score: (C, T, K). sigma_px: (C, T, K), NaN where missing.
    """

    cameras: tuple[str, ...]
    skeleton: Skeleton
    t_ns: Array
    xy_img: Array
    score: Array
    sigma_px: Array

    def __post_init__(self) -> None:
        frozen_fields(self, {"t_ns": "T", "xy_img": "C T K 2", "score": "C T K", "sigma_px": "C T K"})

    @property
    def usable(self) -> Array:
        """(C, T, K) whether a keypoint is seen well enough to be used."""
        return np.isfinite(self.xy_img).all(axis=-1) & (self.score >= _LEAST_SCORE) & (self.sigma_px > 0)

    def at(self, time_steps: Array) -> PersonViews:
        """Only the time steps of a mask or of indices."""
        return replace(
            self, t_ns=self.t_ns[time_steps], xy_img=self.xy_img[:, time_steps], score=self.score[:, time_steps],
            sigma_px=self.sigma_px[:, time_steps],
        )  # fmt: skip

    def tracks(self) -> tuple[PersonTrack, ...]:
        """The same as one track per camera."""
        columns = zip(self.cameras, self.xy_img, self.score, self.sigma_px, strict=True)
        return tuple(PersonTrack(name, self.skeleton, self.t_ns, *values) for name, *values in columns)


def person_views(tracks: Sequence[PersonTrack], clocks: ClockEstimate | None = None) -> PersonViews:
    """All cameras at the times of the one with most frames, interpolated where others looked at other times.

    Args:
        tracks: of at least two cameras. clocks: of the cameras in this order; None takes their stamps as they are.
    """
    taken = [track.t_ns / 1e9 if clocks is None else clocks.taken_s(c, track.t_ns / 1e9) for c, track in enumerate(tracks)]
    longest = max(range(len(tracks)), key=lambda c: len(taken[c]))
    t_s = taken[longest]
    xy = np.stack([at_times(t, track.xy_img, t_s) for t, track in zip(taken, tracks, strict=True)])
    sigma = np.stack([_of_both(t, track.sigma_px, t_s, np.maximum) for t, track in zip(taken, tracks, strict=True)])
    score = np.stack([_of_both(t, track.score, t_s, np.minimum) for t, track in zip(taken, tracks, strict=True)])
    score = np.where(np.isfinite(xy).all(axis=-1), score, 0.0)
    names = tuple(track.camera for track in tracks)
    return PersonViews(names, tracks[0].skeleton, np.round(t_s * 1e9).astype(np.int64), xy, score, sigma)


def _of_both(t_s: Array, values: Array, wanted_s: Array, which: np.ufunc) -> Array:
    """(W, K) the larger or the smaller value of the two frames about each moment."""
    after = np.searchsorted(t_s, wanted_s).clip(0, len(t_s) - 1)
    before = np.where(t_s[after] > wanted_s, after - 1, after).clip(0)
    return np.asarray(which(values[before], values[after]))


# frames of a camera with two people or more, from which on they count as several; and the share of a track in the longest
_SEVERAL_SHARE, _LEAST_SHARE = 0.1, 0.2
_MOST_TRACKS = 4
# a person is the one of the frame before when so near, in shares of the longer side of the body's box; and lost after
_SAME_PERSON, _LOST_S = 0.5, 1.0
_MOST_POINTS, _LEAST_POINTS = 1500, 60
_EPIPOLAR_PX = 6.0


@dataclass(frozen=True, eq=False)
class ChosenPerson:
    """One person in all cameras.

    Attributes:
        tracks: one per camera, in the order of the cameras. several_in: cameras that see further people.
    """

    tracks: tuple[PersonTrack, ...]
    several_in: tuple[str, ...] = ()


def choose_person(detections: Mapping[str, Sequence[Detections2D]], cameras: tuple[Camera, ...]) -> ChosenPerson:
    """The person to calibrate from: the one that is there, or of several the one that most cameras see together for longest.

    Args:
        detections: all people of each camera, frame by frame. cameras: intrinsics, in the order of `detections`.

    Raises:
        CalibrationError: as `person_tracks`.
    """
    prominent = person_tracks(detections)
    people = [_without_duplicates(frames) for frames in detections.values()]
    several = tuple(name for name, frames in zip(detections, people, strict=True) if _see_several(frames))
    if not several:
        return ChosenPerson(prominent)
    tracks = [people_tracks(name, frames) for name, frames in zip(detections, people, strict=True)]
    if not all(tracks):
        return ChosenPerson(prominent, several)
    agreeing = _agreeing(tracks, cameras)
    best = max(_sets_of_tracks(tracks, agreeing), key=lambda chosen: _worth(chosen, agreeing))
    return ChosenPerson(tuple(tracks[c][i] for c, i in enumerate(best)), several)


def people_tracks(camera: str, frames: Sequence[Detections2D]) -> tuple[PersonTrack, ...]:
    """Every person that a camera sees for long, the longest first; at the times of all frames, NaN where they are absent."""
    frames = sorted(frames, key=lambda frame: frame.t_ns)
    going: list[_Going] = []
    ended: list[_Going] = []
    for i, frame in enumerate(frames):
        ended += [one for one in going if frame.t_ns - one.last_ns > _LOST_S * 1e9]
        going = [one for one in going if frame.t_ns - one.last_ns <= _LOST_S * 1e9]
        _follow(going, i, frame)
    by_length = sorted([*ended, *going], key=lambda one: -len(one.rows))
    long = [one for one in by_length if len(one.rows) >= _LEAST_SHARE * len(by_length[0].rows)]
    return tuple(PersonTrack.of(camera, frames, one.rows) for one in long[:_MOST_TRACKS])


@dataclass(eq=False)
class _Going:
    """A person who is being followed: (frame, person) so far, and the keypoints (K, 2) last, with the body's speed in px/s."""

    rows: list[tuple[int, int]]
    last_ns: int
    xy_img: Array
    speed: Array

    def expected(self, t_ns: int) -> Array:
        return self.xy_img + self.speed * ((t_ns - self.last_ns) / 1e9)

    def add(self, row: tuple[int, int], t_ns: int, xy_img: Array) -> None:
        """The next detection; a keypoint that is missing in it is carried along."""
        moved = np.nanmedian(xy_img - self.xy_img, axis=0)
        carried = self.expected(t_ns)
        self.speed = (self.speed + moved / max((t_ns - self.last_ns) / 1e9, 1e-3)) / 2
        self.xy_img = np.where(np.isfinite(xy_img), xy_img, carried)
        self.rows.append(row)
        self.last_ns = t_ns


def _follow(going: list[_Going], i: int, frame: Detections2D) -> None:
    """Give the people of a frame to those who are followed, each to the nearest; the others begin.

    All keypoints count: where two people cross, their middles are at one place. By the middles, tracks of 16 simulated sessions
    with two or three walkers went from one person to another 178 times, and 9 times so.
    """
    seen = np.flatnonzero(np.isfinite(frame.xy_img).all(axis=-1).any(axis=-1))
    xy = frame.xy_img[seen]
    size = np.array([np.ptp(one[np.isfinite(one[:, 0])], axis=0).max() for one in xy])
    expected = np.array([one.expected(frame.t_ns) for one in going]).reshape(-1, *frame.xy_img.shape[1:])
    away = bodies_apart(xy, expected, frame.skeleton.mirror) / np.maximum(size, 1.0)[:, None]
    taken: set[int] = set()
    for p, g in zip(*linear_sum_assignment(np.minimum(away, 10 * _SAME_PERSON)), strict=True):
        if away[p, g] <= _SAME_PERSON:
            going[g].add((i, int(seen[p])), frame.t_ns, xy[p])
            taken.add(int(p))
    for p in range(len(seen)):
        if p not in taken:
            going.append(_Going([(i, int(seen[p]))], frame.t_ns, xy[p], np.zeros(2)))


def _without_duplicates(frames: Sequence[Detections2D]) -> list[Detections2D]:
    return [frame.people(~duplicates(frame, DUPLICATE_SHARE)) for frame in frames]


def _see_several(frames: Sequence[Detections2D]) -> bool:
    """Whether two people or more are there in a good part of the frames."""
    count = np.array([int(np.isfinite(frame.xy_img).all(axis=-1).any(axis=-1).sum()) for frame in frames])
    return bool((count >= 2).sum() >= _SEVERAL_SHARE * max(1, int((count >= 1).sum())))


Agreeing = dict[tuple[int, int], Array]


def _agreeing(tracks: Sequence[Sequence[PersonTrack]], cameras: tuple[Camera, ...]) -> Agreeing:
    """For two cameras a < b: (n_a, n_b) how many keypoints of two tracks agree, times the share of theirs that does."""
    return {
        (a, b): np.array([[_pair(one, other, cameras[a], cameras[b]) for other in tracks[b]] for one in tracks[a]])
        for a, b in combinations(range(len(tracks)), 2)
    }


def _pair(one: PersonTrack, other: PersonTrack, camera: Camera, other_camera: Camera) -> float:
    views = person_views([one, other])
    both = views.usable.all(axis=0)
    p, q = camera.norm_from_px(views.xy_img[0][both]), other_camera.norm_from_px(views.xy_img[1][both])
    known = np.isfinite(p).all(axis=1) & np.isfinite(q).all(axis=1)
    shared = int(known.sum())
    if shared < _LEAST_POINTS:
        return 0.0
    picked = np.flatnonzero(known)[:: max(1, shared // _MOST_POINTS)]
    limit = _EPIPOLAR_PX / float((camera.K[0, 0] + other_camera.K[0, 0]) / 2)
    essential, inlier = cv2.findEssentialMat(p[picked], q[picked], np.eye(3), cv2.RANSAC, 0.999, limit)
    share = 0.0 if essential is None or essential.shape != (3, 3) else float(inlier.mean())
    return share * share * shared


def _sets_of_tracks(tracks: Sequence[Sequence[PersonTrack]], agreeing: Agreeing) -> list[tuple[int, ...]]:
    """One track per camera, grown from each single track by those that agree most with the set so far."""
    found = []
    for first, mine in enumerate(tracks):
        for i in range(len(mine)):
            chosen = {first: i}
            while len(chosen) < len(tracks):
                gains = {
                    (c, j): sum(_of(agreeing, (d, k), (c, j)) for d, k in chosen.items())
                    for c in range(len(tracks)) if c not in chosen for j in range(len(tracks[c]))
                }  # fmt: skip
                c, j = max(gains, key=lambda key: (gains[key], -key[0], -key[1]))
                chosen[c] = j
            found.append(tuple(chosen[c] for c in range(len(tracks))))
    return found


def _of(agreeing: Agreeing, one: tuple[int, int], other: tuple[int, int]) -> float:
    (a, i), (b, j) = sorted((one, other))
    return float(agreeing[a, b][i, j])


def _worth(chosen: tuple[int, ...], agreeing: Agreeing) -> float:
    return sum(_of(agreeing, one, other) for one, other in combinations(enumerate(chosen), 2))
