"""Clocks of calibrated cameras from what moves in front of them: offset and drift of each.

Works for keypoints of a person and for corners of a prop alike, and tolerates small errors of the rig, since a constant error of
each camera about each point is allowed for. The recording is cut into blocks; their disagreement gives the standard error.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from posefuse.calibration.bundle import clustered_covariance
from posefuse.calibration.clocks.person_tracks import MIN_SCORE, limb_keypoints
from posefuse.calibration.report import CalibrationReport, Check
from posefuse.core import CalibrationError, Rig, Skeleton
from posefuse.core.arrays import Array

from .paths import ACCELERATIONS_M_S2, APART_S, LEAST_VIEWS, LONGEST_STEP_S, SETTLED_S, ClockSums, MovingViews, Paths, apart
from .person_tracks import PersonTrack
from .start import RoughClocks, rough_clocks

# seconds of a block, what is looked at besides at its ends, and how many blocks are looked at, spread over the recording
_BLOCK_S, _MARGIN_S, _MOST_BLOCKS = 4.0, 0.3, 30
# what a network's lasting errors move clocks by, however long the recording: as on the walks of `python -m paper drift`
_LASTING_S = 1.5e-3
# of offsets and drifts before anything is seen
_BEFORE_S, _BEFORE_DRIFT = 0.3, 3e-3


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


@dataclass(frozen=True, eq=False)
class ClockFit:
    """Clocks, and how they came about.

    Attributes:
        clocks: the result. spread_px: (C,) how far a camera's points usually are off the paths.
        block_s: (B,) middle of each block. blocks: what each gives for the remaining offsets.
    """

    clocks: ClockEstimate
    spread_px: Array
    block_s: Array
    blocks: tuple[ClockSums, ...]


def estimate_clocks(rig: Rig, tracks: Sequence[PersonTrack], start: ClockEstimate, with_drift: bool = False) -> ClockFit:
    """Clocks of all cameras together, from clocks that are right to some frames.

    Args:
        tracks: one per camera of the rig, of the same keypoints. start: as `clocks.start` finds them.

    Raises:
        CalibrationError: no two cameras saw the points at one time.
    """
    blocks = _blocks(rig, tracks, start)
    if not blocks:
        raise CalibrationError("clocks: no two cameras saw the same points at one time, however their stamps are shifted")
    paths = [Paths(rig, views) for _, views in blocks]
    block_s = np.array([middle for middle, _ in blocks])
    design = _design(block_s - start.middle_s, len(rig), with_drift)
    first = np.concatenate([start.offset_s, start.drift])[: design.shape[2]]
    first = first - np.repeat(first.reshape(-1, len(rig)).mean(axis=1), len(rig))
    value, prior = first.copy(), _only_differences(len(rig), with_drift)
    for acceleration in ACCELERATIONS_M_S2:
        sums = [one.step(turn @ value, acceleration) for one, turn in zip(paths, design, strict=True)]
        information, pulls = _gathered(design, sums)
        step = np.linalg.solve(information + prior, pulls.sum(axis=0) - prior @ (value - first))
        step[: len(rig)] = np.clip(step[: len(rig)], -LONGEST_STEP_S, LONGEST_STEP_S)
        value = value + step
        if acceleration == ACCELERATIONS_M_S2[-1] and np.abs(step[: len(rig)]).max() < SETTLED_S:
            break
    covariance = clustered_covariance(np.linalg.inv(information + prior), pulls, np.arange(len(pulls)))
    clocks = _against_first(value, covariance, len(rig), start.middle_s)
    return ClockFit(clocks, _spread_px(paths, len(rig)), block_s, tuple(sums))


def _blocks(rig: Rig, tracks: Sequence[PersonTrack], start: ClockEstimate) -> list[tuple[float, MovingViews]]:
    """Middle and views of each block in which two cameras saw enough."""
    taken = [start.taken_s(c, track.t_s) for c, track in enumerate(tracks)]
    begin = sorted(t[0] for t in taken if len(t))[1]
    end = sorted(t[-1] for t in taken if len(t))[-2]
    count = max(1, round((end - begin) / _BLOCK_S))
    edges = np.linspace(begin, max(end, begin), count + 1)
    chosen = np.unique(np.linspace(0, count - 1, min(count, _MOST_BLOCKS)).round().astype(int))
    norm = [camera.norm_from_px(track.xy_img) for camera, track in zip(rig, tracks, strict=True)]
    blocks = []
    for k in chosen:
        rows = [np.flatnonzero((t >= edges[k] - _MARGIN_S) & (t <= edges[k + 1] + _MARGIN_S)) for t in taken]
        inside = [some[apart(t[some], APART_S)] for t, some in zip(taken, rows, strict=True)]
        c = np.repeat(np.arange(len(rig)), [len(rows) for rows in inside])
        xy = np.concatenate([norm[i][rows] for i, rows in enumerate(inside)])
        seen = np.isfinite(xy[..., 0]).any(axis=1)
        if (np.bincount(c[seen], minlength=len(rig)) >= LEAST_VIEWS).sum() >= 2:
            stamps = np.concatenate([tracks[i].t_s[rows] for i, rows in enumerate(inside)])
            blocks.append((float(edges[k] + edges[k + 1]) / 2, MovingViews(c[seen], stamps[seen], xy[seen])))
    return blocks


def _design(since_s: Array, cameras: int, with_drift: bool) -> Array:
    """(B, C, unknowns) offsets at each block from offsets in the middle, and drifts."""
    same = np.broadcast_to(np.eye(cameras), (len(since_s), cameras, cameras))
    return np.concatenate([same, same * since_s[:, None, None]], axis=2) if with_drift else same


def _gathered(design: Array, sums: Sequence[ClockSums]) -> tuple[Array, Array]:
    """Information of all blocks together, and pull (B, unknowns) of each."""
    turned = np.swapaxes(design, 1, 2)
    information = turned @ np.stack([one.information for one in sums]) @ design
    return information.sum(axis=0), np.einsum("buc,bc->bu", turned, np.stack([one.pull for one in sums]))


def _only_differences(cameras: int, with_drift: bool) -> Array:
    """Information that holds the means at 0, and each about where it was before anything is seen."""
    same = np.ones((cameras, cameras)) / cameras**2 * 1e6 + np.eye(cameras)
    scales = (_BEFORE_S, _BEFORE_DRIFT) if with_drift else (_BEFORE_S,)
    return np.kron(np.diag([scale**-2 for scale in scales]), same)


def _against_first(value: Array, covariance: Array, cameras: int, middle_s: float) -> ClockEstimate:
    to_first = np.eye(cameras) - np.eye(cameras)[0]
    parts = []
    for begin in range(0, len(value), cameras):
        own = slice(begin, begin + cameras)
        parts.append((to_first @ value[own], np.sqrt(np.diag(to_first @ covariance[own, own] @ to_first.T))))
    parts.append((np.zeros(cameras), np.zeros(cameras)))
    offset_sigma_s = np.where(np.arange(cameras) > 0, np.hypot(parts[0][1], _LASTING_S), 0.0)
    return ClockEstimate(parts[0][0], parts[1][0], offset_sigma_s, parts[1][1], middle_s)


def _left(blocks: Sequence[ClockSums]) -> tuple[Array, Array]:
    """Offsets (C,) about the result with standard errors, from some of the blocks alone."""
    cameras = len(blocks[0].pull)
    prior = _only_differences(cameras, False)
    information = sum((one.information for one in blocks), prior)
    left = np.linalg.solve(information, sum(one.pull for one in blocks))
    return left, np.sqrt(np.diag(np.linalg.inv(information)))


def _spread_px(paths: Sequence[Paths], cameras: int) -> Array:
    c = np.concatenate([one.camera for one in paths])
    left = np.concatenate([one.left_px for one in paths])
    mine = [left[c == i] for i in range(cameras)]
    return np.array([np.median(one) if len(one) else np.nan for one in mine])


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


def _require(done: Sequence[Check]) -> None:
    CalibrationReport(SUBJECT, tuple(done)).require()


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
        (first, first_sigma), (second, second_sigma) = _left(fit.blocks[:count]), _left(fit.blocks[count:])
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
    )  # fmt: skip
