"""Joint angles: against a gait laboratory, against the simulator's truth, after the real pipeline; and how long they take.

python bench/kinematics.py lab FunctionalWalk.c3d
python bench/kinematics.py truth SESSION/truth/truth.npz
python bench/kinematics.py tracked RESULT SESSION/truth/truth.npz
python bench/kinematics.py speed SESSION/truth/truth.npz
"""

import argparse
import time
from pathlib import Path

import numpy as np

from posefuse.core import Joints, PoseSequence, Truth
from posefuse.evaluate.angles import AngleError, angle_errors
from posefuse.evaluate.lab import joints_from_lab, poses_from_lab
from posefuse.evaluate.metrics import joint_errors
from posefuse.files.recording import read_recording
from posefuse.files.truth import read_truth
from posefuse.kinematics import JointSettings, JointTracker, joints_from_poses
from posefuse.kinematics.body import BodyTracker, bodies_from_poses, fit_poses, fit_views

IDEAL_HINGES = JointSettings(hinge_play_rad=0.0, turn_rate_rad_sqrt_s=20.0)
LIMB_FLEXION = ("hip flexion", "knee flexion", "elbow flexion", "ankle dorsiflexion")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("lab", "truth", "tracked", "speed"))
    parser.add_argument("paths", nargs="+", type=Path)
    args = parser.parse_args()
    {"lab": lab, "truth": truth, "tracked": tracked, "speed": speed}[args.what](*args.paths)


def lab(path: Path) -> None:
    errors = angle_errors(joints_from_poses(poses_from_lab(path)), joints_from_lab(path))
    print(f"{path.name}: angles from joint centres minus the laboratory's Plug-in-Gait angles, degrees")
    table(errors)


def truth(path: Path) -> None:
    exact = read_truth(path)
    sequence = exact_poses(exact)
    print("from exact joint centres, minus the body model's own angles, degrees (ideal hinges)")
    table(angle_errors(joints_from_poses(sequence, IDEAL_HINGES), with_joints(exact)))
    print("\nthe same with the settings for real people")
    table(angle_errors(joints_from_poses(sequence), with_joints(exact)))


def tracked(result: Path, truth_path: Path) -> None:
    recording, exact = read_recording(result), read_truth(truth_path)
    bodies = bodies_from_poses(recording.poses)
    fits = {"points": fit_poses(recording.poses, bodies=bodies), "rays": fit_views(recording, bodies=bodies)}
    for name, (joints, poses) in {
        "without the whole-body fit": (joints_from_poses(recording.poses), recording.poses),
        "whole-body fit to points": (fits["points"].joints, fits["points"].poses),
        "whole-body fit to rays": (fits["rays"].joints, fits["rays"].poses),
    }.items():
        print(f"\n{name}: MPJPE {joint_errors(poses, exact).mpjpe_mm:.1f} mm over 14 joints; angles minus truth, degrees")
        table(angle_errors(joints, with_joints(exact)))
    print("\nsegment lengths, mm (spread over time)")
    for person, body in bodies.items():
        print(
            f"  person {person}: "
            + ", ".join(f"{n} {1e3 * v.value_m:.0f} ({1e3 * v.spread_m:.0f})" for n, v in body.lengths.items())
        )


def speed(path: Path) -> None:
    sequence = noisy(exact_poses(read_truth(path)), 0.012)
    poses = [sequence.at(i) for i in range(len(sequence))]
    tracker = JointTracker(sequence.skeleton)
    body_tracker = BodyTracker(bodies_from_poses(sequence))
    for name, step in (("frames + angles, live", tracker.step), ("whole-body fit, live", body_tracker.step)):
        step(poses[0])
        took_us = []
        for pose in poses[1:]:
            began = time.perf_counter()
            step(pose)
            took_us.append(1e6 * (time.perf_counter() - began))
        people = len(sequence.person_id)
        print(f"{name}: median {np.median(took_us):.0f} us, p95 {np.percentile(took_us, 95):.0f} us for {people} people")
    for name, whole in (("frames + angles, recorded", joints_from_poses), ("whole-body fit, recorded", fit_poses)):
        whole(sequence)
        began = time.perf_counter()
        whole(sequence)
        print(f"{name}: {1e6 * (time.perf_counter() - began) / len(sequence):.0f} us per instant")


def exact_poses(exact: Truth) -> PoseSequence:
    shape = exact.xyz_world.shape[:3]
    cov = np.broadcast_to(np.eye(3) * 1e-10, (*shape, 3, 3))
    return PoseSequence(
        exact.t_ns, exact.skeleton, exact.person_id, exact.xyz_world, cov, np.zeros(shape), np.full(shape, 4), np.ones(shape)
    )


def noisy(sequence: PoseSequence, sigma_m: float) -> PoseSequence:
    noise = np.random.default_rng(0).normal(size=sequence.xyz_world.shape) * sigma_m
    cov = np.broadcast_to(np.eye(3) * sigma_m**2, sequence.cov_world.shape)
    return PoseSequence(
        sequence.t_ns, sequence.skeleton, sequence.person_id, sequence.xyz_world + noise, cov, sequence.reproj_px,
        sequence.n_views, sequence.kind,
    )  # fmt: skip


def with_joints(exact: Truth) -> Joints:
    if exact.joints is None:
        raise SystemExit("this truth has no joint angles")
    return exact.joints


def table(errors: list[AngleError]) -> None:
    print(f"  {'joint':16s}{'angle':22s}{'bias':>8s}{'sd':>8s}{'rmse':>8s}{'stated':>8s}{'defined':>9s}")
    for e in errors:
        if e.defined > 0:
            numbers = "".join(f"{value:8.2f}" for value in (e.bias_deg, e.sd_deg, e.rmse_deg, e.stated_deg))
            print(f"  {e.joint:16s}{e.angle:22s}{numbers}{100 * e.defined:8.0f}%")
    chosen = [e for e in errors if f"{e.joint.split('_', 1)[-1]} {e.angle}" in LIMB_FLEXION and e.defined > 0]
    print(f"  mean rmse of {len(chosen)} limb flexion angles: {np.mean([e.rmse_deg for e in chosen]):.2f}")


if __name__ == "__main__":
    main()
