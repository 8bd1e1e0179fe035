"""Joint angles: against a gait laboratory, against the simulator's truth, after the real pipeline; and how long they take.

    python bench/kinematics.py [--session examples/demo] [--lab ../shared/data/btk/FunctionalWalk.c3d]

Angles are those found minus those of the reference, degrees: the laboratory's Plug-in-Gait angles from its own joint centres; the
body model's from exact joint centres, with ideal hinges and with the settings for real people; the truth of a tracked session,
without the whole-body fit and fitted to points. Tables on stderr, one JSON object on stdout. The laboratory part is left
out, by name, where its file is not there.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from angle_errors import AngleError, angle_errors, joints_from_lab, poses_from_lab
from harness import DATA, DEMO, answer, arguments, exact_poses, note, tracked, truth_of

from posefuse.core import JointAngles, PoseSequence, Recording
from posefuse.evaluation.metrics import joint_errors
from posefuse.kinematics import JointSettings, JointTracker, joints_from_poses
from posefuse.kinematics.body import bodies_from_poses, fit_poses

IDEAL_HINGES = JointSettings(hinge_play_rad=0.0, turn_rate_rad_sqrt_s=20.0)
LIMB_FLEXION = ("hip flexion", "knee flexion", "elbow flexion", "ankle dorsiflexion")
Angles = tuple[JointAngles, JointAngles]


def of_lab(path: Path) -> dict[str, Angles]:
    if not path.is_file():
        note(f"laboratory: left out, {path.name} is not on this machine")
        return {}
    return {f"{path.name}, joint centres of the laboratory": (joints_from_poses(poses_from_lab(path)), joints_from_lab(path))}


def of_truth(exact: PoseSequence, joints: JointAngles) -> dict[str, Angles]:
    return {
        "exact joint centres, ideal hinges": (joints_from_poses(exact, IDEAL_HINGES), joints),
        "exact joint centres, settings for real people": (joints_from_poses(exact), joints),
    }


def fits(recording: Recording) -> dict[str, tuple[JointAngles, PoseSequence]]:
    bodies = bodies_from_poses(recording.poses)
    points = fit_poses(recording.poses, bodies=bodies)
    for person, body in bodies.items():
        lengths = ", ".join(f"{n} {1e3 * v.value_m:.0f} ({1e3 * v.spread_m:.0f})" for n, v in body.lengths.items())
        note(f"segment lengths of person {person}, mm (spread over time): {lengths}")
    return {
        "real network, without the whole-body fit": (joints_from_poses(recording.poses), recording.poses),
        "real network, whole-body fit to points": (points.joints, points.poses),
    }


def limb_flexion_deg(errors: Sequence[AngleError]) -> float:
    """Mean RMSE of the limbs' flexion angles."""
    chosen = [e for e in errors if f"{e.joint.split('_', 1)[-1]} {e.angle}" in LIMB_FLEXION and e.defined > 0]
    return float(np.mean([e.rmse_deg for e in chosen]))


def speed(exact: PoseSequence) -> list[dict]:
    noise = np.random.default_rng(0).normal(size=exact.xyz_world.shape) * 0.012
    cov = np.broadcast_to(np.eye(3) * 0.012**2, exact.cov_world.shape)
    sequence = replace(exact, xyz_world=exact.xyz_world + noise, cov_world=cov)
    tracker = JointTracker(sequence.skeleton)
    took_us = [microseconds(tracker.step, sequence.at(i)) for i in range(len(sequence))][1:]
    live = {"median_us": float(np.median(took_us)), "p95_us": float(np.percentile(took_us, 95))}
    rows = [{"what": "frames and angles, live", **live}]
    for name, whole in (("frames and angles, recorded", joints_from_poses), ("whole-body fit, recorded", fit_poses)):
        whole(sequence)
        rows.append({"what": name, "median_us": microseconds(whole, sequence) / len(sequence)})
    return rows


def microseconds(call: Callable[..., object], given: object) -> float:
    began = time.perf_counter()
    call(given)
    return 1e6 * (time.perf_counter() - began)


def main() -> None:
    args = arguments(__doc__, session=DEMO, lab=DATA / "btk" / "FunctionalWalk.c3d")
    truth = truth_of(args.session)
    if truth.joints is None:
        raise SystemExit("this truth has no joint angles")
    found, exact = fits(tracked(args.session)), exact_poses(truth, truth.t_ns)
    angles = {**of_lab(args.lab), **of_truth(exact, truth.joints)}
    angles |= {name: (joints, truth.joints) for name, (joints, _) in found.items()}
    errors = {name: angle_errors(*pair) for name, pair in angles.items()}
    tables = {name: [asdict(one) for one in part if one.defined > 0] for name, part in errors.items()}
    means = [{"joint angles from": name, "mean RMSE, deg": limb_flexion_deg(part)} for name, part in errors.items()]
    positions = [{"poses": name, "mpjpe_mm": joint_errors(poses, truth).mpjpe_mm} for name, (_, poses) in found.items()]
    answer(args, {**tables, "Limb flexion": means, "Positions, 14 joints": positions, "Speed": speed(exact)})


if __name__ == "__main__":
    main()
