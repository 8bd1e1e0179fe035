"""Clocks of cameras with unknown extrinsics, from a person: taken as synchronised first, then poses and clocks in one solve."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from posefuse.calibration.clocks.person import (
    LATE_SIGMA,
    MOST_JUMP_S,
    SUBJECT,
    check_clocks_determined,
    check_linked,
    check_one_offset,
    check_person_in_tracks,
    middle_s,
    moving_keypoints,
)
from posefuse.calibration.clocks.person_tracks import PersonTrack
from posefuse.calibration.clocks.start import rough_clocks_unplaced
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration
from posefuse.calibration.solving.point_solve import DRIFT, LATE, PointSolution
from posefuse.core import CalibrationError, Camera
from posefuse.core.arrays import Array

from .bundle import PersonSolution, freed, solve_person_bundle
from .checks import check_synchronised, solution_fits
from .scale import KnownLength
from .solve import PersonCalibration, calibrate_from_person
from .views import person_views

_MOST_ROUNDS, _SETTLED_S = 6, 3e-4
# clocks need fewer keypoints than poses
_POINTS = 1200
# two halves of a recording, each with a rig of its own, may state clocks that are so far apart
_HALVES_S = 0.03


def unplaced_clocks(
    tracks: Sequence[PersonTrack], cameras: tuple[Camera, ...], length: KnownLength, clocks: str, most_s: float
) -> ClockEstimate | None:
    """First estimate of the cameras' clocks from the person; None where they are synchronised, or assumed to be.

    Args:
        tracks: one per camera. clocks: one of `CLOCK_MODES` of a prop, and read as there.
        most_s: the farthest two cameras' clocks may be apart.

    Raises:
        CalibrationError: the person does not determine them; RefusedCalibration where a check fails.
    """
    if clocks == "together":
        return None
    names, moving = [track.camera for track in tracks], [moving_keypoints(track) for track in tracks]
    CalibrationReport(SUBJECT, (check_person_in_tracks(names, moving),)).require()
    zero = ClockEstimate.known(np.zeros(len(tracks)), middle_s(tracks))
    if clocks == "auto" and _synchronised(tracks, cameras):
        return None
    with suppress(CalibrationError):
        near, solved = _settled(tracks, cameras, zero, clocks == "drift")
        if solution_fits(cameras, solved.solution, solved.rows):
            return near
    # farther apart than the steps of a solve reach
    rough = rough_clocks_unplaced(cameras, moving, most_s)
    linked = check_linked(names, rough, most_s)
    report = CalibrationReport(SUBJECT, (check_one_offset(names, rough) if linked.passed else linked,))
    if report.failed and clocks == "auto":
        # what is wrong with them as their stamps are comes first
        try:
            calibrate_from_person(person_views(tracks), cameras, length)
        except RefusedCalibration as refused:
            raise RefusedCalibration(replace(refused.report, checks=(*refused.report.checks, *report.failed))) from None
    report.require()
    return _settled(tracks, cameras, ClockEstimate.known(rough.offset_s, zero.middle_s), clocks == "drift")[0]


def at_clocks(tracks: Sequence[PersonTrack], clocks: ClockEstimate) -> tuple[PersonTrack, ...]:
    """The tracks with their stamps corrected, as `calibrate_tracks` takes them."""
    return tuple(replace(track, t_ns=1e9 * clocks.taken_s(c, track.t_s)) for c, track in enumerate(tracks))


def _synchronised(tracks: Sequence[PersonTrack], cameras: tuple[Camera, ...]) -> bool:
    """Whether a rig fits the cameras as their stamps are, and clocks that are let free stay."""
    with suppress(CalibrationError):
        solved = solve_person_bundle(person_views(tracks), cameras, _POINTS)
        fits = solution_fits(cameras, solved.solution, solved.rows)
        return fits and check_synchronised(cameras, freed(cameras, solved, focal=True)).passed
    return False


def calibrate_tracks(
    tracks: Sequence[PersonTrack],
    cameras: tuple[Camera, ...],
    length: KnownLength,
    first: ClockEstimate | None,
    with_drift: bool,
    upside_down: tuple[str, ...] = (),
) -> tuple[PersonCalibration, ClockEstimate | None]:
    """The rig, and the clocks where the cameras are not synchronised.

    Args:
        tracks: one per camera, corrected by the clocks that were found first. first: these; None for synchronised cameras.

    Raises:
        CalibrationError: as `calibrate_from_person`. RefusedCalibration (one of them, with the report): a check fails.
    """
    if first is None:
        return calibrate_from_person(person_views(tracks), cameras, length, upside_down), None
    names = [track.camera for track in tracks]
    both, solved = _settled(tracks, cameras, ClockEstimate.known(np.zeros(len(tracks)), middle_s(tracks)), with_drift)
    found = calibrate_from_person(person_views(tracks, both), cameras, length, upside_down)
    apart_s = _halves_apart_s(tracks, cameras, both)
    # clocks absorb errors of the rig: two halves with separate rigs show that, the residuals of the fit do not
    shared_s = float(np.sqrt((apart_s[1:] ** 2).mean())) / 2
    sigma_s = np.where(np.arange(len(tracks)) > 0, np.hypot(both.offset_sigma_s, shared_s), 0.0)
    left = replace(both, offset_sigma_s=sigma_s)
    checks = [check_clocks_determined(names, left), _check_halves(names, apart_s)]
    if not with_drift:
        checks.append(_check_steady(names, freed(cameras, solved, drift=True), -float(solved.rows.since_s.min())))
    report = replace(found.report, checks=(*found.report.checks, *checks))
    report.require()
    return replace(found, report=report), first.then(left)


def _halves_apart_s(tracks: Sequence[PersonTrack], cameras: tuple[Camera, ...], clocks: ClockEstimate) -> Array:
    """(C,) difference between the clocks of the first and the second half of the recording, each solved with a separate rig."""
    offsets = []
    for second in (False, True):
        part = []
        for c, track in enumerate(tracks):
            t_s = clocks.taken_s(c, track.t_ns / 1e9)
            part.append(track.at((t_s >= clocks.middle_s) == second))
        offsets.append(_settled(part, cameras, clocks, False)[0].offset_s)
    return np.asarray(offsets[1] - offsets[0])


def _check_halves(names: Sequence[str], apart_s: Array) -> Check:
    worst = int(np.argmax(np.abs(apart_s)))
    return Check(
        "clocks of halves agree", bool(np.abs(apart_s[worst]) <= _HALVES_S),
        f"from separate data {names[worst]}'s clock differs by {apart_s[worst] * 1e3:+.1f} ms (limit {_HALVES_S * 1e3:.0f})",
        "walk longer and over the whole floor, turning this way and that",
    )  # fmt: skip


def _check_steady(names: Sequence[str], free: PointSolution, half_s: float) -> Check:
    """Clock rates that are let free stay where they are: against the median, since the held one may be the one that drifts."""
    drift, sigma = free.state.terms[:, DRIFT], free.terms_sigma[:, DRIFT]
    apart_s = (drift - np.median(drift)) * half_s
    limit_s = np.maximum(MOST_JUMP_S, LATE_SIGMA * np.maximum(sigma, np.median(sigma)) * half_s)
    c = int(np.argmax(np.abs(apart_s) / limit_s))
    return Check(
        "parts agree", bool(abs(apart_s[c]) <= limit_s[c]),
        f"{names[c]} runs {apart_s[c] * 1e3:+.1f} ms later in the second half than in the first (limit {limit_s[c] * 1e3:.1f})",
        "its clock runs at another rate: try `clocks=drift`; or frames were lost, or come at no constant rate, without a note in"
        " its file: use the part before or after", "drift",
    )  # fmt: skip


def _settled(
    tracks: Sequence[PersonTrack], cameras: tuple[Camera, ...], start: ClockEstimate, with_drift: bool
) -> tuple[ClockEstimate, PersonSolution]:
    """Poses and clocks in one solve, and the views read again at the clocks found, until these stay; and the last solve."""
    clocks, near = start, None
    for _ in range(_MOST_ROUNDS):
        views = person_views(tracks, clocks)
        solved = solve_person_bundle(views, cameras, _POINTS, near)
        free = freed(cameras, solved, drift=with_drift)
        near = replace(solved, solution=free)
        left = _left(free, clocks.middle_s)
        clocks = clocks.then(left)
        if np.abs(left.offset_s).max() < _SETTLED_S:
            break
    return clocks, solved


def _left(free: PointSolution, middle_s: float) -> ClockEstimate:
    """What is left of clocks and their rates, against the first camera."""
    apart, sigma = free.state.terms - free.state.terms[0], np.hypot(free.terms_sigma, free.terms_sigma[0])
    sigma[0] = 0
    return ClockEstimate(apart[:, LATE], apart[:, DRIFT], sigma[:, LATE], sigma[:, DRIFT], middle_s)
