"""Rigs from a person alone, for `bench/calibrate.py`: against the truth of rendered walks, and on real footage."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from harness import rendered

from paper.scenes.scenes import scene_name, walking_scene
from posefuse.calibration.clocks.person_tracks import person_tracks
from posefuse.calibration.extrinsics.self_checks import camera_differences, scale_of
from posefuse.calibration.extrinsics.world import beside_others
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.person.solve import PersonCalibration, calibrate_from_person
from posefuse.calibration.person.views import PersonViews, person_views
from posefuse.calibration.report import RefusedCalibration
from posefuse.calibration.solving.rotations import Poses, poses_of
from posefuse.core import Camera, Rig
from posefuse.detection.build import DetectorChoice
from posefuse.formats.pose2d import read_openpose_folder
from posefuse.formats.rig import read_rig
from posefuse.pipeline.person_poses import person_in_videos
from posefuse_sim import SessionPaths
from posefuse_sim.body.body import completed_shape
from posefuse_sim.scene import read_scene

# where `python -m paper` keeps its own: the first walk is the one it reports
SESSIONS = Path("out/paper/sessions")
# seed, seconds, frames per second, cameras; bodies and ways that are in no fit
WALKS = ((1, 60.0, 30.0, 4), (41, 30.0, 6.0, 4), (42, 30.0, 6.0, 4), (43, 30.0, 6.0, 8))
SECONDS = (20.0, 30.0, 60.0)
# of `pose2sim_single`, and about that of any other walker
STATURE_M = 1.75
REAL_RATE_HZ = 60.0
LEAST_SCORE = 0.5
NETWORKS = ("blazepose_full", "blazepose_heavy")


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


def simulated(only: int = 0) -> dict[str, list[dict]]:
    """Worst camera against the truth, for walks of some lengths; the real network on rendered videos; `only` one seed, or all.

    The true height is given, so the scale has the error of the height's model alone.
    """
    rows = []
    for seed, longest_s, rate_hz, count in WALKS:
        if only not in (0, seed):
            continue
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
        "halves": halves_of(found),
    }


def halves_of(found: PersonCalibration) -> str:
    return next(check.detail for check in found.report.checks if check.name == "halves agree")


def real(data: Path) -> dict[str, list[dict]]:
    """`pose2sim_single`: rigs from several detectors, compared with each other and with the marker system's rig.

    And, in both kinds of rig, by how much all keypoints of a camera together lie next to where the other cameras see them:
    what a detector gets wrong differs from keypoint to keypoint, what a camera's pose gets wrong does not.
    """
    reference = read_rig(data / "calibration" / "Calib_qualisys.toml")
    length, rigs, rows = KnownLength(stature_m=STATURE_M), {"reference": reference}, []
    for name, (views, cameras) in _estimates(data, reference, length).items():
        placed = Rig(tuple(replace(camera, cam_from_world=reference[camera.name].cam_from_world) for camera in cameras))
        rows.append({"from": name, "off in the reference, px": off_px(placed, views)})
        try:
            found = calibrate_from_person(views, cameras, length)
        except RefusedCalibration as refused:
            rows[-1]["refused"] = str(refused)
            continue
        rigs[name] = found.rig
        rows[-1] |= {"off in its own rig, px": off_px(found.rig, views), "halves": halves_of(found)}
    pairs = []
    for a, b in combinations(rigs, 2):
        millimetres, degrees = (dict(zip(reference.names, values, strict=True)) for values in after_similarity(rigs[a], rigs[b]))
        pairs.append({"rig": b, "against": a, "position_mm": millimetres, "rotation_deg": degrees})
    return {"Estimates": rows, "Against each other": pairs}


def off_px(rig: Rig, views: PersonViews) -> dict:
    """Per camera, median (x, y) over all keypoints and time steps from what it saw to where the others' rays meet."""
    xy = np.where((views.score >= LEAST_SCORE)[..., None], views.xy_img, np.nan)
    off = beside_others(rig, xy.reshape(len(rig), -1, 2))
    return dict(zip(rig.names, np.nanmedian(off, axis=1).round(1).tolist(), strict=True))


def folders_of(data: Path, rig: Rig) -> dict[str, Path]:
    """OpenPose's files of each camera."""
    return {name: data / "openpose_json" / f"{name.replace('_', '')}_json" for name in rig.names}


def _estimates(data: Path, lenses: Rig, length: KnownLength) -> dict[str, tuple[PersonViews, tuple[Camera, ...]]]:
    videos = {name: data / "videos" / f"{name.replace('_', '')}.mp4" for name in lenses.names}
    seen = {
        network: person_in_videos(videos, lenses, length, DetectorChoice(options={"landmarks": network})) for network in NETWORKS
    }
    found = {network: (person_views(one.tracks), one.cameras) for network, one in seen.items()}
    folders = folders_of(data, lenses)
    poses = {name: list(read_openpose_folder(folder, name).frames(REAL_RATE_HZ)) for name, folder in folders.items()}
    return {**found, "OpenPose": (person_views(person_tracks(poses)), lenses.cameras)}
