"""Clocks of recordings that were not synchronised, found from the person: errors against shifts that are known.

    python bench/clocks_recorded.py [--seeds 21]   rendered walks, the real 2D network, stamps shifted; rig known, and unknown
    python bench/clocks_recorded.py --real DATA    pose2sim_single as it is, and with one camera shifted by whole frames

Two cameras keep the even frames and two the odd ones, so that no two neighbours ever look at one moment. Constants were
chosen on the walks of `python -m paper drift`; the coarse search was tried on oracle detections of these walks as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from calibrate_person import REAL_RATE_HZ, STATURE_M, after_similarity, folders_of, rendered_walk
from harness import answer, arguments, note

from posefuse.calibration.clocks.person_tracks import PersonTrack, person_tracks
from posefuse.calibration.clocks.sync import ClockEstimate, clocks_from_person
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.person.solve import at_clocks, calibrate_tracks, unplaced_clocks
from posefuse.core import CalibrationError, Rig
from posefuse.detection.build import DetectorChoice, build_detector
from posefuse.formats.pose2d import read_openpose_folder
from posefuse.formats.rig import read_rig
from posefuse.pipeline.person_poses import poses_apart, timeline_of
from posefuse.sources import VideoConfig

# by seed: seconds, and how many of them have to do when the rig is not known; all at 30 Hz
WALKS = {1: (60.0, 20.0), 21: (12.0, 12.0), 22: (12.0, 12.0), 23: (12.0, 12.0)}
PHASES = (0, 1, 0, 1)
FIRST = "within 0.3 s"
LATE_S = {
    FIRST: (0.0, 0.2083, -0.1917, 0.0541),
    "one 3.7 s": (0.0, 3.7117, -0.2, 0.1),
    "two, seconds": (0.0, -2.4183, 3.0291, 0.0),
}
DRIFT = (0.0, 50e-6, -50e-6, 0.0)
MOST_S = 10.0
SHIFTED_FRAMES = (0, 0, 12, 0)


def tracks_of(rig: Rig, session: Path) -> tuple[PersonTrack, ...]:
    """The person in every frame of the videos, as the first look of `posefuse calibrate` has it."""
    sources = [VideoConfig(session / "videos" / f"{name}.mp4", name).build() for name in rig.names]
    found = poses_apart(sources, build_detector(DetectorChoice(), rig), timeline_of(sources, np.inf, np.inf))
    return person_tracks(found)


def until(tracks: Sequence[PersonTrack], seconds: float, phases: Sequence[int] = PHASES) -> list[PersonTrack]:
    """Every second frame of the first seconds, the even or the odd ones."""
    return [track.at(np.flatnonzero(track.t_ns < seconds * 1e9)[phase::2]) for track, phase in zip(tracks, phases, strict=True)]


def shifted(tracks: Sequence[PersonTrack], late_s: Sequence[float], drift: Sequence[float] | None = None) -> list[PersonTrack]:
    """With stamps that are late by so much in the middle, and run by so much fast."""
    middle_s, out = tracks[0].t_ns.mean() / 1e9, []
    for track, late, fast in zip(tracks, late_s, drift or np.zeros(len(late_s)), strict=True):
        t_s = track.t_ns / 1e9
        out.append(replace(track, t_ns=np.round((t_s + late + fast * (t_s - middle_s)) * 1e9)))
    return out


def with_rig(rig: Rig, tracks: Sequence[PersonTrack], late_s: Sequence[float], drift: Sequence[float] | None = None) -> dict:
    """Error and stated standard error of each camera's offset, or the refusal."""
    try:
        found = clocks_from_person(rig, shifted(tracks, late_s, drift), MOST_S, drift is not None)
    except CalibrationError as refused:
        return {"refused": str(refused)}
    figures = clock_errors(found.clocks, late_s)
    if drift is not None:
        figures["drift_error_ppm"] = (1e6 * (found.clocks.drift - drift)).round(1).tolist()
        figures["drift_sigma_ppm"] = (1e6 * found.clocks.drift_sigma).round(1).tolist()
    return figures


def clock_errors(clocks: ClockEstimate, late_s: Sequence[float]) -> dict:
    return {
        "worst_ms": float(np.abs(clocks.offset_s - late_s).max() * 1e3),
        "error_ms": (1e3 * (clocks.offset_s - late_s)).round(2).tolist(),
        "sigma_ms": (1e3 * clocks.offset_sigma_s).round(2).tolist(),
    }


def alone(rig: Rig, tracks: Sequence[PersonTrack], late_s: Sequence[float]) -> dict:
    """Worst camera and clock when both are solved from the person, as `--clocks auto` does."""
    length, tracks, figures = KnownLength(stature_m=STATURE_M), shifted(tracks, late_s), {}
    try:
        first = unplaced_clocks(tracks, rig.cameras, length, "auto", MOST_S)
        corrected = tracks if first is None else at_clocks(tracks, first)
        found, clocks = calibrate_tracks(corrected, rig.cameras, length, first, with_drift=False)
        if clocks is not None:
            figures = clock_errors(clocks, late_s)
    except CalibrationError as refused:
        return {"refused": str(refused)}
    millimetres, degrees = after_similarity(rig, found.rig)
    taken = "synchronised" if clocks is None else "estimated"
    return {"clocks": taken, "position_mm": float(millimetres.max()), "rotation_deg": float(degrees.max()), **figures}


def simulated(seeds: Sequence[int]) -> dict[str, list[dict]]:
    known, alone_rows = [], []
    for seed in seeds:
        seconds, alone_s = WALKS[seed]
        session = rendered_walk(seed, seconds)
        rig = read_rig(session / "rig.toml")
        tracks = tracks_of(rig, session)
        cut, about = until(tracks, seconds), {"seed": seed, "seconds": seconds}
        for name, late_s, drift in (*((name, late_s, None) for name, late_s in LATE_S.items()), ("50 ppm", LATE_S[FIRST], DRIFT)):
            known.append({**about, "late": name, **with_rig(rig, cut, late_s, drift)})
            note(known[-1])
        for name, phases, late_s in (
            ("synchronised", (0, 0, 0, 0), np.zeros(4)),
            *((name, PHASES, LATE_S[name]) for name in (FIRST, "one 3.7 s")),
        ):
            found = alone(rig, until(tracks, alone_s, phases), late_s)
            alone_rows.append({"seed": seed, "seconds": alone_s, "late": name, **found})
            note(alone_rows[-1])
    return {"Rig known": known, "Person alone": alone_rows}


def real(data: Path) -> dict[str, list[dict]]:
    """OpenPose's JSON of 1.7 s of a man on a beam, in the marker system's rig."""
    rig = read_rig(data / "calibration" / "Calib_qualisys.toml")
    folders = folders_of(data, rig)
    tracks = person_tracks({name: list(read_openpose_folder(path, name).frames(REAL_RATE_HZ)) for name, path in folders.items()})
    late_s = np.array(SHIFTED_FRAMES) / REAL_RATE_HZ
    cases = {"as it is": np.zeros(4), "cam_03 by 12 frames": late_s}
    return {"Real footage": [{"shifted": name, **with_rig(rig, tracks, late)} for name, late in cases.items()]}


def main() -> None:
    args = arguments(__doc__, real=Path, seeds=dict.fromkeys(WALKS))
    answer(args, real(args.real) if args.real else simulated(args.seeds))


if __name__ == "__main__":
    main()
