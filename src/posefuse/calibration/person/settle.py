"""Clocks of cameras with unknown extrinsics, from a person: rig and clocks are solved in turn until they converge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from posefuse.calibration.clocks.person import (
    LATE_SIGMA,
    SUBJECT,
    check_one_offset,
    check_person_in_tracks,
    fit_checks,
    middle_s,
    moving_keypoints,
)
from posefuse.calibration.clocks.person_tracks import PersonTrack
from posefuse.calibration.clocks.start import rough_clocks_unplaced
from posefuse.calibration.clocks.sync import ClockEstimate, ClockFit, estimate_clocks
from posefuse.calibration.report import CalibrationReport, Check
from posefuse.core import CalibrationError, Camera, Rig
from posefuse.core.arrays import Array

from .scale import KnownLength
from .solve import PersonCalibration, calibrate_from_person, rough_rig
from .views import person_views

_MOST_ROUNDS = 6
_SETTLED_S, _FARTHEST = 3e-4, 4.0
# a rig from half of a recording and its clocks may be so far off together
_HALVES_S = 0.03
# a rig that is good enough for clocks needs so many time steps
_INSTANTS = 60
# cameras closer together than a third of a usual frame are synchronised, whatever clocks would take up of a rig's own errors
_IN_STEP_S = 0.01


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
    moving = [moving_keypoints(track) for track in tracks]
    CalibrationReport(SUBJECT, (check_person_in_tracks([track.camera for track in tracks], moving),)).require()
    start = ClockEstimate.known(np.zeros(len(tracks)), middle_s(tracks))
    try:
        rig, fit = _settled(tracks, cameras, length, start, clocks == "drift")
        if clocks == "auto" and _in_step(fit.clocks):
            return None
        CalibrationReport(SUBJECT, tuple(fit_checks(rig, fit, clocks == "drift"))).require()
        return fit.clocks
    except CalibrationError:
        # farther apart than a step of the solve reaches
        rough = rough_clocks_unplaced(cameras, moving, most_s)
    lost = [track.camera for track, offset in zip(tracks, rough.offset_s, strict=True) if not np.isfinite(offset)]
    linked = Check("cameras are linked", not lost, f"{', '.join(lost)}: no way over the floor is like that of the others",
                   "walk where two cameras see you together, turning this way and that")  # fmt: skip
    CalibrationReport(SUBJECT, (linked,)).require()
    CalibrationReport(SUBJECT, (check_one_offset([track.camera for track in tracks], rough),)).require()
    _, fit = _settled(tracks, cameras, length, ClockEstimate.known(rough.offset_s, start.middle_s), clocks == "drift")
    return fit.clocks


def calibrate_out_of_step(
    tracks: Sequence[PersonTrack],
    cameras: tuple[Camera, ...],
    length: KnownLength,
    start: ClockEstimate,
    with_drift: bool,
    upside_down: tuple[str, ...] = (),
) -> tuple[PersonCalibration, ClockEstimate]:
    """Rig and clocks together, from clocks that are nearly right.

    Raises:
        CalibrationError: as `calibrate_from_person`. RefusedCalibration (one of them, with the report): a check fails.
    """
    rig, fit = _settled(tracks, cameras, length, start, with_drift)
    checks = fit_checks(rig, fit, with_drift)
    CalibrationReport(SUBJECT, tuple(checks)).require()
    found = calibrate_from_person(person_views(tracks, fit.clocks), cameras, length, upside_down)
    apart_s = _halves_apart_s(tracks, cameras, length, fit.clocks)
    checks.append(_check_halves([track.camera for track in tracks], apart_s))
    report = replace(found.report, checks=(*found.report.checks, *checks))
    report.require()
    # clocks absorb errors of the rig: two halves with separate rigs show that, the residuals of the fit do not
    shared_s = float(np.sqrt((apart_s[1:] ** 2).mean())) / 2
    sigma_s = np.where(np.arange(len(tracks)) > 0, np.hypot(fit.clocks.offset_sigma_s, shared_s), 0.0)
    return replace(found, report=report), replace(fit.clocks, offset_sigma_s=sigma_s)


def _halves_apart_s(
    tracks: Sequence[PersonTrack], cameras: tuple[Camera, ...], length: KnownLength, clocks: ClockEstimate
) -> Array:
    """(C,) difference between the clocks of the first and the second half of the recording, each solved with a separate rig."""
    offsets = []
    for second in (False, True):
        part = []
        for c, track in enumerate(tracks):
            t_s = clocks.taken_s(c, track.t_ns / 1e9)
            part.append(track.at((t_s >= clocks.middle_s) == second))
        offsets.append(_settled(part, cameras, length, clocks, False)[1].clocks.offset_s)
    return np.asarray(offsets[1] - offsets[0])


def _check_halves(names: Sequence[str], apart_s: Array) -> Check:
    worst = int(np.argmax(np.abs(apart_s)))
    return Check(
        "clocks of halves agree", bool(np.abs(apart_s[worst]) <= _HALVES_S),
        f"from separate data {names[worst]}'s clock differs by {apart_s[worst] * 1e3:+.1f} ms (limit {_HALVES_S * 1e3:.0f})",
        "walk longer and over the whole floor, turning this way and that",
    )  # fmt: skip


def _settled(
    tracks: Sequence[PersonTrack], cameras: tuple[Camera, ...], length: KnownLength, start: ClockEstimate, with_drift: bool
) -> tuple[Rig, ClockFit]:
    moving, clocks = [moving_keypoints(track) for track in tracks], start
    before: tuple[ClockEstimate, ClockEstimate] | None = None
    for _ in range(_MOST_ROUNDS):
        views = person_views(tracks, clocks)
        rig = rough_rig(views.at(np.linspace(0, len(views.t_ns) - 1, _INSTANTS).astype(int)), cameras, length)
        fit = estimate_clocks(rig, moving, clocks, with_drift)
        if np.abs(fit.clocks.offset_s - clocks.offset_s).max() < _SETTLED_S:
            break
        before, clocks = (clocks, fit.clocks), _ahead(before, (clocks, fit.clocks))
    return rig, fit


def _ahead(before: tuple[ClockEstimate, ClockEstimate] | None, now: tuple[ClockEstimate, ClockEstimate]) -> ClockEstimate:
    """Where rounds that lead from the first of a pair to the second are heading, by the last two (Anderson 1965).

    A person who walks round in one sense leaves rig and clocks to settle by turns for long otherwise.
    """
    start, end = now
    if before is None:
        return end
    step, step_before = end.offset_s - start.offset_s, before[1].offset_s - before[0].offset_s
    change = step - step_before
    share = float(np.clip(-(step @ change) / max(float(change @ change), 1e-18), 0.0, _FARTHEST))
    further = [now_ + share * (now_ - then) for now_, then in ((end.offset_s, before[1].offset_s), (end.drift, before[1].drift))]
    return replace(end, offset_s=further[0], drift=further[1])


def _in_step(clocks: ClockEstimate) -> bool:
    return bool((np.abs(clocks.offset_s) <= np.maximum(_IN_STEP_S, LATE_SIGMA * clocks.offset_sigma_s)).all())
