"""Joint angles: against a gait laboratory, against the simulator's truth, after the real pipeline; and how long they take.

    python bench/kinematics.py [--session examples/demo] [--lab ../shared/data/btk/FunctionalWalk.c3d]

Tables on stderr, one JSON object on stdout. The laboratory part is left out, by name, where its file is not there.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from posefuse.core import JointAngles, PoseSequence, Truth
from posefuse.evaluation.angles import AngleError, angle_errors
from posefuse.evaluation.biomechanics import rays_at_joint_centres
from posefuse.evaluation.lab import joints_from_lab, poses_from_lab
from posefuse.evaluation.metrics import joint_errors
from posefuse.formats.recording import read_recording
from posefuse.formats.truth import read_truth
from posefuse.kinematics import JointSettings, JointTracker, joints_from_poses
from posefuse.kinematics.body import bodies_from_poses, fit_poses, fit_views

IDEAL_HINGES = JointSettings(hinge_play_rad=0.0, turn_rate_rad_sqrt_s=20.0)
LIMB_FLEXION = ("hip flexion", "knee flexion", "elbow flexion", "ankle dorsiflexion")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--session", type=Path, default=Path("examples/demo"))
    parser.add_argument("--lab", type=Path, default=Path("../shared/data/btk/FunctionalWalk.c3d"))
    args = parser.parse_args()
    exact = read_truth(args.session / "truth" / "truth.npz")
    figures = {"lab": lab(args.lab), "truth": truth(exact), "tracked": tracked(args.session, exact), "speed": speed(exact)}
    print(json.dumps(figures, indent=2))


def say(text: str) -> None:
    print(text, file=sys.stderr)


def lab(path: Path) -> list[dict] | None:
    if not path.is_file():
        say(f"laboratory: left out, {path.name} is not on this machine")
        return None
    say(f"{path.name}: angles from joint centres minus the laboratory's Plug-in-Gait angles, degrees")
    return table(angle_errors(joints_from_poses(poses_from_lab(path)), joints_from_lab(path)))


def truth(exact: Truth) -> dict:
    sequence = exact_poses(exact)
    say("\nfrom exact joint centres, minus the body model's own angles, degrees (ideal hinges)")
    ideal = table(angle_errors(joints_from_poses(sequence, IDEAL_HINGES), with_joints(exact)))
    say("\nthe same with the settings for real people")
    return {"ideal_hinges": ideal, "default": table(angle_errors(joints_from_poses(sequence), with_joints(exact)))}


def tracked(session: Path, exact: Truth) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        command = ["track", str(session), "--out", f"{folder}/result", "--outputs", "", "--json"]
        subprocess.run([sys.executable, "-m", "posefuse.cli.main", *command], check=True, capture_output=True)
        recording = read_recording(Path(folder) / "result")
    bodies = bodies_from_poses(recording.poses)
    fits = {
        "points": fit_poses(recording.poses, bodies=bodies),
        "rays": fit_views(recording.poses, recording.rig, rays_at_joint_centres(recording), bodies=bodies),
    }
    figures = {}
    for name, (joints, poses) in {
        "without the whole-body fit": (joints_from_poses(recording.poses), recording.poses),
        "whole-body fit to points": (fits["points"].joints, fits["points"].poses),
        "whole-body fit to rays": (fits["rays"].joints, fits["rays"].poses),
    }.items():
        mpjpe_mm = joint_errors(poses, exact).mpjpe_mm
        say(f"\nreal network, {name}: MPJPE {mpjpe_mm:.1f} mm over 14 joints; angles minus truth, degrees")
        figures[name] = {"mpjpe_mm": mpjpe_mm, "angles": table(angle_errors(joints, with_joints(exact)))}
    say("\nsegment lengths, mm (spread over time)")
    for person, body in bodies.items():
        lengths = ", ".join(f"{n} {1e3 * v.value_m:.0f} ({1e3 * v.spread_m:.0f})" for n, v in body.lengths.items())
        say(f"  person {person}: {lengths}")
    return figures


def speed(exact: Truth) -> dict:
    sequence = noisy(exact_poses(exact), 0.012)
    poses = [sequence.at(i) for i in range(len(sequence))]
    tracker = JointTracker(sequence.skeleton)
    figures: dict = {"people": len(sequence.person_id)}
    say("")
    tracker.step(poses[0])
    took_us = []
    for pose in poses[1:]:
        began = time.perf_counter()
        tracker.step(pose)
        took_us.append(1e6 * (time.perf_counter() - began))
    live = {"median_us": float(np.median(took_us)), "p95_us": float(np.percentile(took_us, 95))}
    figures["frames and angles, live"] = live
    say(f"frames and angles, live: median {live['median_us']:.0f} us, p95 {live['p95_us']:.0f} us")
    for name, whole in (("frames and angles, recorded", joints_from_poses), ("whole-body fit, recorded", fit_poses)):
        whole(sequence)
        began = time.perf_counter()
        whole(sequence)
        figures[name] = {"us_per_instant": 1e6 * (time.perf_counter() - began) / len(sequence)}
        say(f"{name}: {figures[name]['us_per_instant']:.0f} us per time step")
    return figures


def exact_poses(exact: Truth) -> PoseSequence:
    shape = exact.xyz_world.shape[:3]
    cov = np.broadcast_to(np.eye(3) * 1e-10, (*shape, 3, 3))
    return PoseSequence(
        t_ns=exact.t_ns,
        skeleton=exact.skeleton,
        person_id=exact.person_id,
        xyz_world=exact.xyz_world,
        cov_world=cov,
        reproj_px=np.zeros(shape),
        n_views=np.full(shape, 4),
        kind=np.ones(shape),
    )


def noisy(sequence: PoseSequence, sigma_m: float) -> PoseSequence:
    noise = np.random.default_rng(0).normal(size=sequence.xyz_world.shape) * sigma_m
    cov = np.broadcast_to(np.eye(3) * sigma_m**2, sequence.cov_world.shape)
    return PoseSequence(
        t_ns=sequence.t_ns,
        skeleton=sequence.skeleton,
        person_id=sequence.person_id,
        xyz_world=sequence.xyz_world + noise,
        cov_world=cov,
        reproj_px=sequence.reproj_px,
        n_views=sequence.n_views,
        kind=sequence.kind,
    )


def with_joints(exact: Truth) -> JointAngles:
    if exact.joints is None:
        raise SystemExit("this truth has no joint angles")
    return exact.joints


def table(errors: list[AngleError]) -> list[dict]:
    say(f"  {'joint':16s}{'angle':22s}{'bias':>8s}{'sd':>8s}{'rmse':>8s}{'stated':>8s}{'defined':>9s}")
    rows = []
    for e in errors:
        if e.defined > 0:
            numbers = "".join(f"{value:8.2f}" for value in (e.bias_deg, e.sd_deg, e.rmse_deg, e.stated_deg))
            say(f"  {e.joint:16s}{e.angle:22s}{numbers}{100 * e.defined:8.0f}%")
            rows.append({"joint": e.joint, "angle": e.angle, "bias_deg": e.bias_deg, "sd_deg": e.sd_deg, "rmse_deg": e.rmse_deg})
    chosen = [e for e in errors if f"{e.joint.split('_', 1)[-1]} {e.angle}" in LIMB_FLEXION and e.defined > 0]
    say(f"  mean rmse of {len(chosen)} limb flexion angles: {np.mean([e.rmse_deg for e in chosen]):.2f}")
    return rows


if __name__ == "__main__":
    main()
