"""Rigs and clocks from a person alone: against the truth of rendered walks, and on real footage.

    python bench/calibrate_person.py [--seeds 1 41]              rigs: the real network on rendered walks
    python bench/calibrate_person.py --clocks [--seeds 21]       clocks: stamps shifted by what is known; rig known, and unknown

Of clocks, two cameras keep the even frames and two the odd ones, so that no two neighbours ever look at one time. Constants
were chosen on the walks of `python -m paper drift`; the coarse search was tried on oracle detections of these walks as well.
Tables on stderr, one JSON object on stdout; rendered walks are kept in out/paper/sessions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from faults.sessions import scale_of
from harness import answer, arguments, note, rendered

from paper.scenes.scenes import scene_name, walking_scene
from posefuse.calibration.clocks.person_tracks import PersonTrack, person_tracks
from posefuse.calibration.clocks.sync import ClockEstimate, clocks_from_person
from posefuse.calibration.extrinsics.self_checks import camera_differences
from posefuse.calibration.geometry import Poses, poses_of
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.person.solve import at_clocks, calibrate_from_person, calibrate_tracks, unplaced_clocks
from posefuse.calibration.person.views import PersonViews, person_views
from posefuse.calibration.report import RefusedCalibration
from posefuse.core import CalibrationError, Camera, Rig
from posefuse.detection.build import DetectorChoice, build_detector
from posefuse.formats.rig import read_rig
from posefuse.pipeline.person_poses import person_in_videos, poses_apart, timeline_of
from posefuse.sources import VideoConfig
from posefuse_sim import SessionPaths
from posefuse_sim.body.body import completed_shape
from posefuse_sim.scene import read_scene

# where `python -m paper` keeps its own: the first walk is the one it reports
SESSIONS = Path("out/paper/sessions")
# by seed: seconds, frames per second, cameras; bodies and paths that are in no fit
WALKS = {1: (60.0, 30.0, 4), 41: (30.0, 6.0, 4), 42: (30.0, 6.0, 4), 43: (30.0, 6.0, 8)}
SECONDS = (20.0, 30.0, 60.0)
# about that of any walker
STATURE_M = 1.75


def after_similarity(reference: Rig, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Distance (C,) in mm and angle (C,) in degrees of each camera."""
    first, second = poses_of(reference), poses_of(rig)
    metres, radians = camera_differences(first, Poses(second.R, second.t * scale_of(first, second)))
    return metres * 1e3, np.rad2deg(radians)


def rendered_walk(seed: int, seconds: float, rate_hz: float = 30.0, cameras: int = 4) -> Path:
    """A session with the videos of a walk, rendered when it is not there; a body for each seed."""
    scene = replace(walking_scene(seed, seconds), rate_hz=rate_hz)
    scene = replace(scene, cameras=replace(scene.cameras, count=cameras))
    return rendered(scene, SESSIONS / scene_name(f"walking-{seed}", scene), processes=None)


def height_of(paths: SessionPaths) -> float:
    """True height in metres of the body of a rendered walk."""
    height_m = completed_shape(read_scene(paths.scene).people[0].body).height_m
    assert height_m is not None
    return float(height_m)


def simulated(seeds: Sequence[int]) -> dict[str, list[dict]]:
    """Worst camera against the truth, for walks of some lengths; the real network on rendered videos.

    The true height is given, so the scale has the error of the height's model alone.
    """
    rows = []
    for seed in seeds or WALKS:
        longest_s, rate_hz, count = WALKS[seed]
        paths = SessionPaths(rendered_walk(seed, longest_s, rate_hz, count))
        rig, length = read_rig(paths.rig), KnownLength(stature_m=height_of(paths))
        videos = {camera.name: paths.video(camera.name) for camera in rig}
        seen = person_in_videos(videos, rig, length, DetectorChoice())
        views, cameras = person_views(seen.tracks), seen.cameras
        for seconds in (s for s in SECONDS if s <= longest_s):
            part = views.at(views.t_ns < seconds * 1e9)
            rows.append({"seed": seed, "cameras": count, "seconds": seconds, **outcome(rig, part, cameras, length)})
    return {"From a person alone": rows}


def outcome(rig: Rig, views: PersonViews, cameras: tuple[Camera, ...], length: KnownLength) -> dict:
    try:
        found = calibrate_from_person(views, cameras, length)
    except RefusedCalibration as refused:
        return {"refused": str(refused)}
    millimetres, degrees = after_similarity(rig, found.rig)
    return {
        "position_mm": float(millimetres.max()),
        "rotation_deg": float(degrees.max()),
        "scale_percent": 100 * (1 / scale_of(poses_of(rig), poses_of(found.rig)) - 1),
    }


# by seed: seconds, and how many of them have to do when the rig is not known; all at 30 Hz
CLOCK_WALKS = {1: (60.0, 20.0), 21: (12.0, 12.0), 22: (12.0, 12.0), 23: (12.0, 12.0)}
PHASES = (0, 1, 0, 1)
FIRST = "within 0.3 s"
LATE_S = {
    FIRST: (0.0, 0.2083, -0.1917, 0.0541),
    "one 3.7 s": (0.0, 3.7117, -0.2, 0.1),
    "two, seconds": (0.0, -2.4183, 3.0291, 0.0),
}
DRIFT = (0.0, 50e-6, -50e-6, 0.0)
MOST_S = 10.0


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


def clocks(seeds: Sequence[int]) -> dict[str, list[dict]]:
    known, alone_rows = [], []
    for seed in seeds or CLOCK_WALKS:
        seconds, alone_s = CLOCK_WALKS[seed]
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


def main() -> None:
    args = arguments(__doc__, seeds=(int,), clocks=False)
    answer(args, clocks(args.seeds) if args.clocks else simulated(args.seeds))


if __name__ == "__main__":
    main()
