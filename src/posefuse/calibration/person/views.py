"""One person in all cameras at common time steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.clocks.paths import at_times
from posefuse.calibration.clocks.person_tracks import PersonTrack
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.core import Skeleton
from posefuse.core.arrays import Array, check_fields, freeze_fields

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
        freeze_fields(self, {"t_ns": np.int64} | dict.fromkeys(("xy_img", "score", "sigma_px"), np.float64))
        check_fields(self, {"t_ns": "T", "xy_img": "C T K 2", "score": "C T K", "sigma_px": "C T K"})

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
