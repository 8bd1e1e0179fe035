"""Clocks of cameras, offset and drift of each, and the checks of clocks that come from a person."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.calibration.clocks.person_tracks import MIN_SCORE, limb_keypoints
from posefuse.calibration.report import CalibrationReport, Check
from posefuse.core import Skeleton
from posefuse.core.arrays import Array

from .person_tracks import PersonTrack
from .start import RoughClocks


@dataclass(frozen=True, eq=False)
class ClockEstimate:
    """offset_s, drift, and their standard errors, each (C,), against one camera, the reference, whose values are all 0.

    From a person it is the first camera, from a target the one that is linked best to the others. A frame that camera c stamped
    s was taken at s - offset - drift * (s - middle_s) on the reference's clock.
    """

    offset_s: Array
    drift: Array
    offset_sigma_s: Array
    drift_sigma: Array
    middle_s: float

    @classmethod
    def known(cls, offset_s: Array, middle_s: float) -> ClockEstimate:
        """Offsets without a doubt and without drift."""
        nothing = np.zeros(len(offset_s))
        return cls(np.asarray(offset_s - offset_s[0]), nothing, nothing, nothing, middle_s)

    def taken_s(self, c: int, stamp_s: Array) -> Array:
        """When camera c took the frames it stamped so."""
        return np.asarray(stamp_s - self.offset_s[c] - self.drift[c] * (stamp_s - self.middle_s))

    def correction(self, c: int) -> tuple[float, float]:
        """What sources add to camera c's stamps to have times on one clock: offset_s, and drift_ppm."""
        return float(self.drift[c] * self.middle_s - self.offset_s[c]), float(-1e6 * self.drift[c])

    def then(self, left: ClockEstimate) -> ClockEstimate:
        """These, with what was still found when they were corrected."""
        offset_s, drift = self.offset_s + left.offset_s, self.drift + left.drift
        return ClockEstimate(offset_s, drift, left.offset_sigma_s, left.drift_sigma, self.middle_s)


SUBJECT = "clocks from a person"
_LEAST_FRAMES = 8
_MOST_RIVALRY, _LEAST_CLEARNESS = 0.85, 0.3
_MOST_SIGMA_S = 0.01
# parts of a recording may differ by so much, or so many standard errors
MOST_JUMP_S, LATE_SIGMA = 0.008, 5.0


@dataclass(frozen=True, eq=False)
class FoundClocks:
    """Clocks that passed their checks."""

    clocks: ClockEstimate
    report: CalibrationReport


def moving_keypoints(track: PersonTrack) -> PersonTrack:
    """Only the keypoints that carry most information about time, NaN where they are not well seen."""
    limbs = limb_keypoints(track.skeleton.keypoints)
    skeleton = Skeleton(f"limbs of {track.skeleton.name}", tuple(track.skeleton.keypoints[k] for k in limbs))
    xy = np.where((track.score >= MIN_SCORE)[..., None], track.xy_img, np.nan)
    return PersonTrack(track.camera, skeleton, track.t_ns, xy[:, limbs], track.score[:, limbs], track.sigma_px[:, limbs])


def middle_s(tracks: Sequence[PersonTrack]) -> float:
    """Middle of the recording in stamps, from which drift counts."""
    return float(np.median([track.t_ns[[0, -1]].mean() for track in tracks])) / 1e9


def clock_figures(names: Sequence[str], clocks: ClockEstimate) -> dict[str, float]:
    """Figures of the clocks for a report."""
    found = {}
    for c, name in enumerate(names):
        found[f"{name}_offset_ms"] = float(clocks.offset_s[c] * 1e3)
        found[f"{name}_offset_sigma_ms"] = float(clocks.offset_sigma_s[c] * 1e3)
        if clocks.drift_sigma.any():
            found[f"{name}_drift_ppm"] = float(clocks.drift[c] * 1e6)
            found[f"{name}_drift_sigma_ppm"] = float(clocks.drift_sigma[c] * 1e6)
    return found


def clock_settings(names: Sequence[str], clocks: ClockEstimate) -> str:
    """The clock offsets as settings that `posefuse track` reads (TOML); empty where the cameras are synchronised.

    A frame stamped s was taken at s - offset - drift * (s - middle), and `track` adds its settings: the signs turn.
    """
    if not (clocks.offset_s.any() or clocks.drift.any()):
        return ""
    return "\n".join(_of_camera(name, *clocks.correction(c)) for c, name in enumerate(names))


def _of_camera(camera: str, offset_s: float, drift_ppm: float) -> str:
    """One camera's table in `posefuse.toml`; drift only where it was estimated."""
    table = f"[cameras.{json.dumps(camera)}]\noffset_s = {offset_s:.6f}\n"
    return table + (f"drift_ppm = {drift_ppm:.3f}\n" if drift_ppm else "")


def check_person_in_tracks(names: Sequence[str], moving: Sequence[PersonTrack]) -> Check:
    """Every camera saw a person."""
    seen = [np.asarray(np.asarray(np.isfinite(track.xy_img).all(axis=-1)).any(axis=1)) for track in moving]
    return person_seen(names, seen, _LEAST_FRAMES)


def person_seen(names: Sequence[str], seen: Iterable[Array], least: int) -> Check:
    """Every camera saw a person in so many of its frames: `seen` (F,) bool of each."""
    blind = [f"{name} ({one.sum()} of {len(one)} frames)" for name, one in zip(names, seen, strict=True) if one.sum() < least]
    detail = f"no person found by {', '.join(blind)}" if blind else "every camera saw the person"
    return Check("person seen", not blind, detail, "walk where this camera looks, or leave it out")


def check_linked(names: Sequence[str], rough: RoughClocks, most_s: float) -> Check:
    """At some offset, every camera sees the person where others do."""
    lost = [name for name, offset in zip(names, rough.offset_s, strict=True) if not np.isfinite(offset)]
    who = "any camera" if len(lost) == len(names) else ", ".join(lost)
    return Check(
        "cameras are linked", not lost,
        f"at no offset within {most_s:g} s does {who} see the person where others do"
        if lost else "at some offset every camera sees the person where others do",
        "walk where two cameras see you together, turning this way and that, and let them run at one time; if they did, search"
        " farther with `max_offset_s=S`",
    )  # fmt: skip


def check_one_offset(names: Sequence[str], rough: RoughClocks) -> Check:
    """No camera has two offsets that fit about equally."""
    faint, worst = int(np.argmin(rough.clearness)), int(np.argmax(rough.rivalry))
    if rough.clearness[faint] < _LEAST_CLEARNESS:
        return Check(
            "one offset fits best", False,
            f"{names[faint]} fits {np.exp(rough.clearness[faint]):.2f} times as well at the best offset as at others"
            f" (needed {np.exp(_LEAST_CLEARNESS):.2f})",
            "too little motion, another person, or a rig of other cameras: walk about, turning this way and that",
        )  # fmt: skip
    return Check(
        "one offset fits best", bool(rough.rivalry[worst] <= _MOST_RIVALRY),
        f"{names[worst]} fits best at {rough.offset_s[worst]:+.1f} s, and {max(0.0, rough.rivalry[worst]):.0%} as well at"
        f" {rough.other_s[worst]:+.1f} s (limit {_MOST_RIVALRY:.0%})",
        "another person, a rig of other cameras, clocks farther apart (`max_offset_s=S`), or too little way: walk about, "
        "turning this way and that",
    )  # fmt: skip


def check_clocks_determined(names: Sequence[str], clocks: ClockEstimate) -> Check:
    """The standard errors of the offsets are small."""
    worst = int(np.argmax(clocks.offset_sigma_s))
    return Check(
        "clocks are determined", bool(clocks.offset_sigma_s[worst] <= _MOST_SIGMA_S),
        f"standard error of {names[worst]}'s offset {clocks.offset_sigma_s[worst] * 1e3:.1f} ms"
        f" (limit {_MOST_SIGMA_S * 1e3:.0f})",
        "record longer, and move more where this camera and others see it",
    )  # fmt: skip
