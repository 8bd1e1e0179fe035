"""Clocks of cameras with known extrinsics, from a person who moves in view; refused where the motion does not determine them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.calibration.keypoints import MIN_SCORE, limb_keypoints
from posefuse.calibration.report import CalibrationReport, Check
from posefuse.core import Rig, Skeleton

from .person_tracks import PersonTrack
from .start import RoughClocks, rough_clocks
from .sync import ClockEstimate, ClockFit, estimate_clocks

SUBJECT = "clocks from a person"
_LEAST_FRAMES = 8
_MOST_RIVALRY, _LEAST_CLEARNESS = 0.85, 0.3
_MOST_SPREAD_PX_PER_1000 = 12.0
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


def clocks_from_person(rig: Rig, tracks: Sequence[PersonTrack], most_s: float, with_drift: bool = False) -> FoundClocks:
    """Offset, and on request drift, of every camera against the first one.

    Args:
        rig: of the cameras in the order of `tracks`. most_s: the farthest two cameras' clocks may be apart.

    Raises:
        RefusedCalibration: a check fails; it carries the report.
    """
    moving = [moving_keypoints(track) for track in tracks]
    done = [check_person_in_tracks(rig.names, moving)]
    _require(done)
    rough = rough_clocks(rig, moving, most_s)
    done.append(check_linked(rig.names, rough, most_s))
    _require(done)
    done.append(check_one_offset(rig.names, rough))
    _require(done)
    fit = estimate_clocks(rig, moving, ClockEstimate.known(rough.offset_s, middle_s(tracks)), with_drift)
    done += [_check_spread(rig, fit), _check_steady(rig.names, fit, with_drift), check_clocks_determined(rig.names, fit.clocks)]
    report = CalibrationReport(SUBJECT, tuple(done), numbers=clock_figures(rig.names, fit.clocks))
    report.require()
    return FoundClocks(fit.clocks, report)


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


def _require(done: Sequence[Check]) -> None:
    CalibrationReport(SUBJECT, tuple(done)).require()


def check_person_in_tracks(names: Sequence[str], moving: Sequence[PersonTrack]) -> Check:
    """Every camera saw a person."""
    seen = [int(np.asarray(np.isfinite(track.xy_img).all(axis=-1)).any(axis=1).sum()) for track in moving]
    blind = [f"{name} ({n} of {len(track.t_ns)} frames)" for name, n, track in zip(names, seen, moving, strict=True)
             if n < _LEAST_FRAMES]  # fmt: skip
    return person_seen(blind)


def person_seen(blind: Sequence[str]) -> Check:
    """No camera is in `blind`, in words."""
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


def _check_spread(rig: Rig, fit: ClockFit) -> Check:
    limit = np.array([_MOST_SPREAD_PX_PER_1000 * max(camera.size_wh) / 1000 for camera in rig])
    worst = int(np.nanargmax(np.nan_to_num(fit.spread_px / limit, nan=np.inf)))
    return Check(
        "paths fit", bool(fit.spread_px[worst] <= limit[worst]),
        f"{rig.names[worst]}'s lie worst, usually {fit.spread_px[worst]:.1f} px off the paths (limit {limit[worst]:.1f})",
        "it follows another person, was moved after the rig was made, or is farther off than searched (`max_offset_s=S`)",
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


def _check_steady(names: Sequence[str], fit: ClockFit, with_drift: bool) -> Check:
    """Of all ways to cut the recording in two, the parts agree on every camera's offset."""
    worst = (0.0, 0, 0.0, 0.0)
    for count in range(1, len(fit.blocks)):
        (first, first_sigma), (second, second_sigma) = fit.parts(count)
        apart, sigma = second - first, np.hypot(first_sigma, second_sigma)
        ratio = np.abs(apart) / np.maximum(MOST_JUMP_S, LATE_SIGMA * sigma)
        c = int(np.argmax(ratio))
        worst = max(worst, (float(ratio[c]), c, float(apart[c]), float(fit.block_s[count - 1 : count + 1].mean())))
    ratio_, c, apart_s, at_s = worst
    if ratio_ == 0:
        return Check("parts agree", True, "the recording is too short to compare its parts")
    remedy = "frames were lost, or come at no constant rate, without a note in its file: use the part before or after"
    return Check(
        "parts agree", ratio_ <= 1,
        f"{names[c]} runs {apart_s * 1e3:+.1f} ms later after {at_s:.0f} s than before (limit"
        f" {abs(apart_s) / ratio_ * 1e3:.1f})",
        remedy if with_drift else f"its clock runs at another rate: try `drift=True`; or {remedy}",
        "record" if with_drift else "drift",
    )  # fmt: skip
