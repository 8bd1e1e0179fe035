"""Rigs from a person alone, for `bench/calibrate.py`: against the truth of rendered walks, and on real footage."""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from posefuse.app.calibrating.person_poses import person_in_videos
from posefuse.app.config import DetectorChoice
from posefuse.app.terminal import Terminal
from posefuse.calibrate.checks import camera_differences, scale_of
from posefuse.calibrate.person import KnownLength, calibrate_from_person
from posefuse.calibrate.person_views import PersonViews, person_views
from posefuse.calibrate.report import RefusedCalibration
from posefuse.calibrate.rotations import Poses, stacked
from posefuse.core import Camera, Rig
from posefuse.detect.openpose import read_openpose_folder
from posefuse.evaluate.experiments.scenes import scene_name, walking_scene
from posefuse.files.rig import read_rig
from posefuse.simulate.session import SessionPaths, simulate

SESSIONS = Path("out/calibration_person")
# bodies and ways that are in no fit and in no other measurement
SEEDS, LONGEST_S, RATE_HZ = (41, 42, 43), 40.0, 6.0
SECONDS = (20.0, 40.0)
STATURE_M = 1.75
INSTANTS = 600
NETWORKS = ("blazepose_full", "blazepose_heavy")


def rigid(rig: Rig) -> Poses:
    return stacked([Poses.from_se3(camera.cam_from_world) for camera in rig])


def after_similarity(reference: Rig, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Distance (C,) in mm and angle (C,) in degrees of each camera."""
    first, second = rigid(reference), rigid(rig)
    metres, radians = camera_differences(first, Poses(second.R, second.t * scale_of(first, second)))
    return metres * 1e3, np.rad2deg(radians)


def simulated(seeds: tuple[int, ...] = SEEDS) -> dict:
    """Worst camera against the truth, for walks of some lengths; the real network on rendered films."""
    figures: dict = {}
    for seed in seeds:
        scene = replace(walking_scene(seed, LONGEST_S), rate_hz=RATE_HZ)
        paths = SessionPaths(SESSIONS / scene_name(f"walking-{seed}", scene))
        if not paths.rig.exists() or paths.incomplete.exists():
            simulate(scene, paths.folder)
        rig = read_rig(paths.rig)
        films = {camera.name: paths.film(camera.name) for camera in rig}
        length = KnownLength(stature_m=STATURE_M)
        views, cameras = person_in_videos(films, rig, length, DetectorChoice(), INSTANTS, Terminal(as_json=True))
        for seconds in SECONDS:
            part = views.at(views.t_ns < seconds * 1e9)
            found = calibrate_from_person(part, cameras, length)
            millimetres, degrees = after_similarity(rig, found.rig)
            figures[f"seed {seed}, {seconds:.0f} s"] = {
                "position_mm": float(millimetres.max()), "rotation_deg": float(degrees.max()),
                "halves": next(check.detail for check in found.report.checks if check.name == "halves agree"),
            }  # fmt: skip
    return figures


def real(data: Path) -> dict:
    """`pose2sim_single`: rigs from several 2D estimators, compared with each other and with the marker system's rig."""
    reference = read_rig(data / "calibration" / "Calib_qualisys.toml")
    length, rigs, halves = KnownLength(stature_m=STATURE_M), {"reference": reference}, {}
    for name, (views, cameras) in _estimates(data, reference, length).items():
        try:
            found = calibrate_from_person(views, cameras, length)
        except RefusedCalibration as refused:
            print(f"{name}: {refused}", file=sys.stderr)
            continue
        rigs[name] = found.rig
        halves[name] = next(check.detail for check in found.report.checks if check.name == "halves agree")
    figures: dict = {"halves": halves}
    for a, b in combinations(rigs, 2):
        millimetres, degrees = after_similarity(rigs[a], rigs[b])
        figures[f"{b} against {a}"] = {
            "position_mm": dict(zip(reference.names, millimetres.round(1).tolist(), strict=True)),
            "rotation_deg": float(degrees.max()),
        }
    return figures


def _estimates(data: Path, lenses: Rig, length: KnownLength) -> dict[str, tuple[PersonViews, tuple[Camera, ...]]]:
    films = {name: data / "videos" / f"{name.replace('_', '')}.mp4" for name in lenses.names}
    found = {
        network: person_in_videos(
            films, lenses, length, DetectorChoice(options={"landmarks": network}), INSTANTS, Terminal(as_json=True)
        )
        for network in NETWORKS
    }
    folders = {name: data / "openpose_json" / f"{name.replace('_', '')}_json" for name in lenses.names}
    poses = {name: list(read_openpose_folder(folder, name).frames(60.0)) for name, folder in folders.items()}
    return {**found, "OpenPose": (person_views(poses), lenses.cameras)}
