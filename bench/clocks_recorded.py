"""Clocks of recordings that were not synchronised, found from the person: errors against shifts that are known.

Run: python bench/clocks_recorded.py                rendered walks, the real 2D network, stamps shifted; rig known, and unknown
     python bench/clocks_recorded.py --real [DATA]  pose2sim_single as it is, and with one camera shifted by whole frames

Two cameras keep the even frames and two the odd ones, so that no two neighbours ever look at one moment. Constants were
chosen on the walks of `python -m paper drift`; the coarse search was tried on oracle detections of these walks as well.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from calibrate_person import REAL_RATE_HZ, STATURE_M, after_similarity, folders_of, rendered_walk

from posefuse.calibration.clocks.person import clocks_from_person
from posefuse.calibration.clocks.person_tracks import PersonTrack, person_tracks
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.person.settle import at_clocks, calibrate_tracks, unplaced_clocks
from posefuse.core import CalibrationError, Rig
from posefuse.detection.build import DetectorChoice, build_detector
from posefuse.formats.pose2d import read_openpose_folder
from posefuse.formats.rig import read_rig
from posefuse.pipeline.person_poses import poses_apart, timeline_of
from posefuse.sources import VideoConfig

# by seed: seconds, and how many of them have to do when the rig is not known; all at 30 Hz
WALKS = {1: (60.0, 20.0), 21: (12.0, 12.0), 22: (12.0, 12.0), 23: (12.0, 12.0)}
PHASES = (0, 1, 0, 1)
LATE_S = {
    "within 0.3 s": (0.0, 0.2083, -0.1917, 0.0541),
    "one 3.7 s": (0.0, 3.7117, -0.2, 0.1),
    "two, seconds": (0.0, -2.4183, 3.0291, 0.0),
}
DRIFT = (0.0, 50e-6, -50e-6, 0.0)
MOST_S = 10.0
REAL = Path("../shared/data/pose2sim_single")
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


def simulated(seeds: Sequence[int]) -> dict:
    figures: dict = {"rig known": {}, "person alone": {}}
    for seed in seeds:
        seconds, alone_s = WALKS[seed]
        session = rendered_walk(seed, seconds)
        rig = read_rig(session / "rig.toml")
        tracks = tracks_of(rig, session)
        cut, walk = until(tracks, seconds), f"seed {seed}, {seconds:.0f} s"
        for name, late_s in LATE_S.items():
            report(figures["rig known"], f"{walk}, {name}", with_rig(rig, cut, late_s))
        report(figures["rig known"], f"{walk}, and 50 ppm", with_rig(rig, cut, LATE_S["within 0.3 s"], DRIFT))
        walk = f"seed {seed}, {alone_s:.0f} s"
        for name, phases, late_s in (
            ("synchronised", (0, 0, 0, 0), np.zeros(4)),
            ("within 0.3 s", PHASES, LATE_S["within 0.3 s"]),
            ("one 3.7 s", PHASES, LATE_S["one 3.7 s"]),
        ):
            report(figures["person alone"], f"{walk}, {name}", alone(rig, until(tracks, alone_s, phases), late_s))
    return figures


def report(figures: dict, case: str, found: dict) -> None:
    """Keep a case's figures, and show them at once."""
    figures[case] = found
    print(f"{case}: {found}", file=sys.stderr, flush=True)


def real(data: Path) -> dict:
    """OpenPose's JSON of 1.7 s of a man on a beam, in the marker system's rig."""
    rig = read_rig(data / "calibration" / "Calib_qualisys.toml")
    folders = folders_of(data, rig)
    tracks = person_tracks({name: list(read_openpose_folder(path, name).frames(REAL_RATE_HZ)) for name, path in folders.items()})
    late_s = np.array(SHIFTED_FRAMES) / REAL_RATE_HZ
    return {"as it is": with_rig(rig, tracks, np.zeros(4)), "cam_03 by 12 frames": with_rig(rig, tracks, late_s)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--real", type=Path, nargs="?", const=REAL, metavar="DATA", help=f"default {REAL}")
    parser.add_argument("--seeds", type=int, nargs="+", choices=WALKS, default=list(WALKS), help="walks, default all")
    args = parser.parse_args()
    print(json.dumps(real(args.real) if args.real else simulated(args.seeds), indent=2))


if __name__ == "__main__":
    main()
