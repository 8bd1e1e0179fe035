"""What the depth of RGB-D cameras adds to one, two and four cameras: error and honesty of recorded and live tracking.

    python bench/depth.py OUT [--frames 60] [--seed 9400]     the reported tables: rendered people, the bundled network
    python bench/depth.py OUT --fast                          exact keypoints with the error of a network instead, no network
    python bench/depth.py OUT --fit                           how far keypoints lie below the skin: the table in `core.depth`

A person walks in a circle before four cameras, whose depth is that of `simulation.depth.DepthSettings`: MuJoCo's depth with the
noise of a stereo camera. Of the same images, 1, 2 (a quarter of the circle apart) and 4 cameras are used, with and without
depth. OUT keeps the rendered session. Bodies of seeds 9400 and 9401 appear nowhere else; `--fit` uses those from 8100 on.

Printed per row: how often a joint has a place, the mean distance of the twelve large joints from the truth (MPJPE), its 95th
percentile, the mean squared error in units of the stated covariance (NEES: 3 when it is honest), and how often the error along
an axis is below two stated standard deviations (95 % when it is honest). One JSON object on stdout.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from live_tracking import SIGMA_PX, noise
from rich.console import Console
from rich.table import Table

from posefuse.association import AssociateSettings
from posefuse.core import Detections2D, JointCentres, Pose3D, PoseSequence, Rig, Truth
from posefuse.core.observations import observations_from_frames, on_time_steps
from posefuse.core.skeleton import pick_keypoints
from posefuse.core.view_sequences import views_over_time
from posefuse.detection import with_depth
from posefuse.detection.build import build_detector
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.depth_images import DepthFolder
from posefuse.formats.truth import read_truth
from posefuse.foundation.settings import settings_from_mapping
from posefuse.fusion import FuseSettings, fuse
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.run import track_session
from posefuse.pipeline.second_pass import poses_over_time
from posefuse.pipeline.session import find_session
from posefuse.realtime.fusion import build_fuse, build_solve
from posefuse.simulation.scene import Scene
from posefuse.simulation.session import SessionPaths, simulate
from posefuse.tracking import LearntLengths, SmoothSettings, at_joint_centres
from posefuse.tracking.online import LiveSettings, build_tracker

RATE_HZ = 30.0
CAMERAS = {1: (0,), 2: (0, 1), 4: (0, 1, 2, 3)}
JOINTS = tuple(f"{s}_{j}" for s in ("left", "right") for j in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))
LATE_S = 0.06
FIT_BODIES, FIT_SEED, FIT_FRAMES, FIT_HZ = 3, 8100, 6, 3.0
SURE_SCORE, HIDDEN_SCORE, HIDDEN_FACTOR = 0.9, 0.4, 3.0
WARM_UP_S = 0.5
MODES = ("fused", "recorded", "live")
NO_NOISE = {"disparity_sigma_px": 0.0, "step_px": 0.0, "floor_m": 0.0, "lateral_px": 0.0, "edge_loss": 0.0}

Row = dict[str, object]


def scene(seed: int, frames: int, depth: dict[str, float], rate_hz: float = RATE_HZ) -> Scene:
    """A person on a circle of 0.8 m between four cameras that stand 3.8 m from its centre."""
    image = {"size_px": (640, 360), "horizontal_fov_deg": 69.0}
    cameras = {
        "kind": "ring", "count": 4, "radius_m": 3.8, "height_m": 1.5, "image": image,
        "sensor": {"noise_dn": 2.0, "depth": depth},
    }  # fmt: skip
    walk = {"kind": "walk", "speed_mps": 1.2, "path": {"shape": "circle", "radius_m": 0.8}}
    person = {"body": {"random_seed": seed}, "motion": walk}
    content = {"duration_s": frames / rate_hz, "rate_hz": rate_hz, "seed": seed, "cameras": cameras, "people": [person]}
    return settings_from_mapping(content, Scene, "bench")


def rendered(folder: Path, wanted: Scene) -> SessionPaths:
    """The session of a scene, drawn unless it is there."""
    paths = SessionPaths(folder)
    if not paths.truth.exists():
        simulate(wanted, folder, processes=1)
    return paths


def erring_frames(paths: SessionPaths, seed: int) -> tuple[Truth, list[Detections2D]]:
    """Every view in the order of time: exact keypoints with the errors of a network, and the depth sampled where they fall."""
    truth, rng = read_truth(paths.truth), np.random.default_rng(seed)
    frames: list[Detections2D] = []
    for camera, view in zip(truth.rig, truth.views, strict=True):
        t_s = view.t_ns / 1e9
        sigma = SIGMA_PX * np.where(view.visible[:, 0], 1.0, HIDDEN_FACTOR)
        xy = view.xy_img[:, 0] + sigma[..., None] * noise(rng, t_s, len(truth.skeleton))
        score = np.where(view.visible[:, 0], SURE_SCORE, HIDDEN_SCORE)
        depths = DepthFolder(paths.depth(camera.name))
        for i, t_ns in enumerate(view.t_ns.tolist()):
            seen = Detections2D(
                camera=camera.name, t_ns=t_ns, skeleton=truth.skeleton, xy_img=xy[i][None], score=score[i][None],
                sigma_px=sigma[i][None], box_img=np.zeros((1, 4)),
            )  # fmt: skip
            frames.append(with_depth(seen, depths.at(t_ns, camera.size_wh)))
    return truth, sorted(frames, key=lambda one: one.t_ns)


def of_cameras(frames: Sequence[Detections2D], rig: Rig, depth: bool) -> list[Detections2D]:
    """The views of some cameras, with or without depth."""
    mine = [one for one in frames if one.camera in rig.names]
    return mine if depth else [replace(one, depth_m=None) for one in mine]


def poses_of(mode: str, frames: Sequence[Detections2D], rig: Rig, truth: Truth) -> list[Pose3D]:
    """One person's views, each time step by itself (fused), over all of time (recorded), or live."""
    if mode == "live":
        return live_poses(frames, rig)
    log = on_time_steps(observations_from_frames(truth.skeleton, rig.names, frames), truth.t_ns)
    views = views_over_time(log.with_person_ids(np.where(log.frame_step[log.detection_frame] >= 0, 0, -1)), [0])
    if mode == "fused":
        return [fuse(views.at(i), rig, FuseSettings()) for i in range(len(views.t_ns))]
    return sequence(poses_over_time(views, rig, FuseSettings(), SmoothSettings()))


def live_poses(frames: Sequence[Detections2D], rig: Rig, table: JointCentres | None = None) -> list[Pose3D]:
    """The live tracker's pose `LATE_S` after each view, moved to joint centres by the table."""
    solve, fused = build_solve(rig, AssociateSettings(), FuseSettings()), build_fuse(rig, FuseSettings())
    tracker, poses = build_tracker(rig, frames[0].skeleton, LiveSettings(), solve, fused), []
    lengths = LearntLengths(table) if table else None
    for one in frames:
        tracker.add(one)
        pose = tracker.at(one.t_ns + round(LATE_S * 1e9))
        poses.append(at_joint_centres(pose, table, lengths.step(pose)) if table and lengths else pose)
    return poses


def figures(poses: Sequence[Pose3D], truth: Truth) -> dict[str, float]:
    """See the top; over the twelve large joints after the warm-up."""
    misses, covs, asked = [], [], 0
    for pose in poses:
        if not WARM_UP_S < pose.t_ns / 1e9 - truth.t_ns[0] / 1e9 <= (truth.t_ns[-1] - truth.t_ns[0]) / 1e9:
            continue
        asked += len(JOINTS)
        if not len(pose.person_id):
            continue
        true = pick_keypoints(true_xyz_at(truth, np.array([pose.t_ns]))[0, 0], truth.skeleton, JOINTS)
        at = pose.skeleton.indices(JOINTS)
        misses.append(pose.xyz_world[0, at] - true)
        covs.append(pose.cov_world[0, at])
    miss, cov = np.array(misses).reshape(-1, 3), np.array(covs).reshape(-1, 3, 3)
    known = np.isfinite(miss).all(-1)
    miss, cov = miss[known], cov[known]
    if not len(miss):
        return {"known": 0.0}
    away_mm = 1000 * np.linalg.norm(miss, axis=-1)
    nees = np.einsum("ni,nij,nj->n", miss, np.linalg.inv(cov), miss)
    within = np.abs(miss) < 2 * np.sqrt(np.diagonal(cov, axis1=1, axis2=2))
    return {
        "known": len(miss) / asked, "mpjpe_mm": float(away_mm.mean()), "p95_mm": float(np.quantile(away_mm, 0.95)),
        "nees": float(nees.mean()), "nees_median": float(np.median(nees)), "within_2_sigma": float(within.mean()),
    }  # fmt: skip


def fast_rows(paths: SessionPaths, seed: int) -> Iterator[Row]:
    truth, frames = erring_frames(paths, seed)
    for mode in MODES:
        for count, places in CAMERAS.items():
            rig = truth.rig.only([truth.rig.names[c] for c in places])
            for depth in (False, True):
                mine = of_cameras(frames, rig, depth)
                yield {"mode": mode, "cameras": count, "depth": depth} | figures(poses_of(mode, mine, rig, truth), truth)


def sequence(poses: PoseSequence) -> list[Pose3D]:
    return [poses.at(i) for i in range(len(poses))]


def without_depth(paths: SessionPaths) -> Path:
    """A session folder of the same videos and cameras that holds no depth."""
    folder = paths.folder.with_name(paths.folder.name + "_rgb")
    folder.mkdir(exist_ok=True)
    for name in ("rig.toml", "videos"):
        if not (folder / name).exists():
            (folder / name).symlink_to((paths.folder / name).resolve())
    return folder


def network_rows(paths: SessionPaths) -> Iterator[Row]:
    """The whole pipeline of a recording with the bundled network, and the live tracker over what it detected."""
    truth = read_truth(paths.truth)
    for count, places in CAMERAS.items():
        used = [truth.rig.names[c] for c in places]
        for depth in (False, True):
            about = {"cameras": count, "depth": depth}
            if count == 1 and not depth:
                # refused by the pipeline: one camera without depth gives no 3D
                yield from ({"mode": mode} | about | {"known": 0.0} for mode in MODES[1:])
                continue
            skipped = {name: {"skip": True} for name in truth.rig.names if name not in used}
            config = settings_from_mapping({"cameras": skipped}, TrackConfig, "bench")
            session = find_session(paths.folder if depth else without_depth(paths), config)
            done = track_session(session, config, StageClock(), lambda *_: None, _silent, _silent).recording
            yield {"mode": "recorded"} | about | figures(sequence(done.poses), truth)
            frames = [done.observations.detections(i) for i in range(len(done.observations.frame_t_ns))]
            seen = sorted((one for one in frames if len(one)), key=lambda one: one.t_ns)
            table = build_detector(config.detector, done.rig).joint_centres
            yield {"mode": "live"} | about | figures(live_poses(seen, done.rig, table), truth)


def _silent(line: str) -> None:
    print(line, file=sys.stderr)


def below_the_skin(out: Path) -> list[Row]:
    """By keypoint: median and spread of how much deeper than the skin it lies along its ray, where it is in sight."""
    found: dict[str, list[float]] = {}
    for body in range(FIT_BODIES):
        paths = rendered(out / f"fit{body}", scene(FIT_SEED + body, FIT_FRAMES, NO_NOISE, FIT_HZ))
        truth = read_truth(paths.truth)
        for camera, view in zip(truth.rig, truth.views, strict=True):
            depths = DepthFolder(paths.depth(camera.name))
            for i, t_ns in enumerate(view.t_ns.tolist()):
                seen = Detections2D(
                    camera=camera.name, t_ns=t_ns, skeleton=truth.skeleton, xy_img=view.xy_img[i], box_img=np.zeros((1, 4)),
                    score=view.visible[i].astype(float), sigma_px=np.ones(view.visible[i].shape),
                )  # fmt: skip
                surface = with_depth(seen, depths.at(t_ns, camera.size_wh)).depth_m
                assert surface is not None
                in_camera = camera.cam_from_world @ true_xyz_at(truth, np.array([t_ns]))[0, 0]
                slope = np.linalg.norm(in_camera, axis=-1) / in_camera[:, 2]
                below = (in_camera[:, 2] - surface[0, :, 0]) * slope
                for name, value in zip(truth.skeleton.keypoints, below, strict=True):
                    if np.isfinite(value):
                        found.setdefault(name.split("_", 1)[-1], []).append(float(value))
    return [
        {
            "part": part, "views": len(values), "median_m": float(np.median(values)),
            "sigma_m": float(1.4826 * np.median(np.abs(np.array(values) - np.median(values)))),
            "rms_m": float(np.std(values)),
        }
        for part, values in found.items()
    ]  # fmt: skip


def shown(rows: Sequence[Row], title: str) -> None:
    table = Table(title=title)
    for column in rows[0] if len(rows[0]) > len(rows[-1]) else rows[-1]:
        table.add_column(str(column), justify="right")
    for row in rows:
        table.add_row(*(f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()))
    Console(stderr=True).print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--seed", type=int, default=9400)
    parser.add_argument("--fast", action="store_true")
    parser.add_argument("--fit", action="store_true")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    if asked.fit:
        rows = below_the_skin(asked.out)
        shown(rows, "below the skin")
    else:
        paths = rendered(asked.out / f"scene{asked.seed}", scene(asked.seed, asked.frames, {}))
        rows = []
        for row in fast_rows(paths, asked.seed) if asked.fast else network_rows(paths):
            print(row, file=sys.stderr, flush=True)
            rows.append(row)
        shown(rows, f"{'exact keypoints with the error of a network' if asked.fast else 'bundled network'}, body {asked.seed}")
    json.dump(rows, sys.stdout, indent=1)


if __name__ == "__main__":
    main()
