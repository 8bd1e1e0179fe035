"""What the depth of RGB-D cameras adds to one, two and four cameras: error and honesty of recorded and live tracking.

    python bench/depth.py OUT [--frames 60] [--seed 9400]     the reported table: rendered people, the bundled network
    python bench/depth.py OUT --fit                           how far keypoints lie below the skin: the table in `core.depth`

A person walks in a circle before four cameras, whose depth is that of `simulation.depth.DepthSettings`: MuJoCo's depth with the
noise of a stereo camera. Of the same images, 1, 2 (a quarter of the circle apart) and 4 cameras are used, with and without
depth. OUT keeps the rendered session. Bodies of seeds 9400 and 9401 appear nowhere else; `--fit` uses those from 8100 on.

Printed per row: how often a joint has a place, the mean distance of the twelve large joints from the truth (MPJPE), its 95th
percentile, the mean squared error in units of the stated covariance (NEES: 3 when it is honest), and how often the error along
an axis is below two stated standard deviations (95 % when it is honest). One JSON object on stdout.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

import numpy as np
from harness import JOINTS, Use, answer, arguments, covariances, errors, note, rendered, scene_from, score, tracked, truth_of
from scenes import circle

from posefuse.core import Detections2D, LiveJointCentres, Pose3D, Recording, Truth
from posefuse.detection import with_depth
from posefuse.detection.build import DetectorChoice, build_detector
from posefuse.evaluation.metrics import true_xyz_at
from posefuse.formats.image_folders import DepthFolder
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse_sim.scene import Scene
from posefuse_sim.session import SessionPaths

RATE_HZ = 30.0
CAMERAS = {1: (0,), 2: (0, 1), 4: (0, 1, 2, 3)}
LATE_S, WARM_UP_S = 0.06, 0.5
FIT_BODIES, FIT_SEED, FIT_FRAMES, FIT_HZ = 3, 8100, 6, 3.0
NO_NOISE = {"disparity_sigma_px": 0.0, "step_px": 0.0, "floor_m": 0.0, "lateral_px": 0.0, "edge_loss": 0.0}

Row = dict[str, object]


def scene(seed: int, frames: int, depth: dict[str, float], rate_hz: float, use: Use) -> Scene:
    """A person on a circle of 0.8 m between four cameras that stand 3.8 m from its centre."""
    cameras = {
        "kind": "ring", "count": 4, "radius_m": 3.8, "height_m": 1.5, "sensor": {"noise_dn": 2.0, "depth": depth},
        "image": {"size_px": (640, 360), "horizontal_fov_deg": 69.0},
    }  # fmt: skip
    person = {"body": {"random_seed": seed}, "motion": circle(0.8, 1.2)}
    about = {"duration_s": frames / rate_hz, "rate_hz": rate_hz, "seed": seed}
    return scene_from({**about, "cameras": cameras, "people": [person]}, use)


def live_poses(recording: Recording) -> Iterator[Pose3D]:
    """The live tracker's pose `LATE_S` after each view of a recording, at joint centres."""
    log, rig = recording.observations, recording.rig
    estimator = warmed_up(rig, log.skeleton, LiveConfig(body="off"))
    table = build_detector(DetectorChoice(), rig).joint_centres
    estimator.centring.learn(LiveJointCentres(t_ns=0, cameras=rig.names, table=table))
    views = [log.detections(i) for i in np.flatnonzero(log.n_detections)]
    for one in sorted(views, key=lambda view: view.t_ns):
        estimator.tracker.add(one)
        yield estimator.placed(estimator.tracker.at(one.t_ns + round(LATE_S * 1e9)))


def figures(poses: Sequence[Pose3D], truth: Truth) -> dict[str, float]:
    """See the top; over the twelve large joints after the warm-up."""
    inside = [pose for pose in poses if truth.t_ns[0] + WARM_UP_S * 1e9 < pose.t_ns <= truth.t_ns[-1]]
    miss, cov = errors(inside, truth, JOINTS), covariances(inside, JOINTS)
    known = np.isfinite(miss).all(axis=-1)
    within = np.abs(miss[known]) < 2 * np.sqrt(np.diagonal(cov[known], axis1=1, axis2=2))
    return score(miss, cov) | ({"within_2_sigma": float(within.mean())} if known.any() else {})


def without_depth(session: Path) -> Path:
    """A session folder of the same videos and cameras that holds no depth."""
    folder = session.with_name(session.name + "_rgb")
    folder.mkdir(exist_ok=True)
    for name in ("rig.toml", "videos"):
        if not (folder / name).exists():
            (folder / name).symlink_to((session / name).resolve())
    return folder


def network_rows(session: Path) -> Iterator[Row]:
    """The whole pipeline of a recording with the bundled network, and the live tracker over what it detected."""
    truth = truth_of(session)
    for (count, places), depth in product(CAMERAS.items(), (False, True)):
        about = {"cameras": count, "depth": depth}
        if count == 1 and not depth:
            # refused by the pipeline: one camera without depth gives no 3D
            yield from ({"mode": mode} | about | {"found": 0.0} for mode in ("recorded", "live"))
            continue
        used = [truth.rig.names[c] for c in places]
        skipped = {f"cameras__{name}__skip": True for name in truth.rig.names if name not in used}
        done = tracked(session if depth else without_depth(session), **skipped)
        yield {"mode": "recorded"} | about | figures([done.poses.at(i) for i in range(len(done.poses))], truth)
        yield {"mode": "live"} | about | figures(list(live_poses(done)), truth)


def below_the_skin(out: Path) -> list[Row]:
    """By keypoint: median and spread of how much deeper than the skin it lies along its ray, where it is in sight."""
    found: dict[str, list[float]] = {}
    for body in range(FIT_BODIES):
        session = rendered(scene(FIT_SEED + body, FIT_FRAMES, NO_NOISE, FIT_HZ, Use.FIT), out / f"fit{body}", Use.FIT)
        truth = truth_of(session)
        for camera, view in zip(truth.rig, truth.views, strict=True):
            depths = DepthFolder(SessionPaths(session).depth(camera.name))
            for i, t_ns in enumerate(view.t_ns.tolist()):
                score, box = view.visible[i, :1].astype(float), np.zeros((1, 4))
                parts = {"xy_img": view.xy_img[i, :1], "score": score, "sigma_px": score + 1, "box_img": box}
                seen = Detections2D(camera=camera.name, t_ns=t_ns, skeleton=truth.skeleton, **parts)
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


def main() -> None:
    args = arguments(__doc__, positional=("out",), out=Path, frames=60, seed=9400, fit=False)
    if args.fit:
        answer(args, {"Below the skin": below_the_skin(args.out)})
        return
    session = rendered(scene(args.seed, args.frames, {}, RATE_HZ, Use.REPORT), args.out / f"scene{args.seed}")
    rows = []
    for row in network_rows(session):
        note(row)
        rows.append(row)
    answer(args, {f"Bundled network, body {args.seed}": rows})


if __name__ == "__main__":
    main()
