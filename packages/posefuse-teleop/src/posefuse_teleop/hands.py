"""One live pose -> input of teleoperation: the hands with their uncertainty, and the position of the body."""

from __future__ import annotations

import numpy as np

from posefuse.core import Kind, Pose3D
from posefuse.core.poses import worst_sigma_m
from posefuse.core.skeleton import pick_keypoints

from .values import OperatorView

# keypoints of the body for the separation; no detector measures the last five, the farthest points of hands, head and feet
BODY = (
    "nose", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist",
    "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle",
    "neck", "mid_hip", "left_fingertips", "right_fingertips", "crown", "left_toes", "right_toes",
)  # fmt: skip
# bones between them, and their greatest length, m: of a person 2 m tall (Winter 2009) with raised shoulders
BONES = {
    ("nose", "crown"): 0.2, ("nose", "neck"): 0.3, ("neck", "mid_hip"): 0.65,
    ("left_shoulder", "neck"): 0.26, ("right_shoulder", "neck"): 0.26,
    ("left_hip", "mid_hip"): 0.19, ("right_hip", "mid_hip"): 0.19,
    **{(f"{side}_{a}", f"{side}_{b}"): length_m for side in ("left", "right") for a, b, length_m in (
        ("shoulder", "elbow", 0.37), ("elbow", "wrist", 0.29), ("wrist", "fingertips", 0.2), ("shoulder", "hip", 0.65),
        ("hip", "knee", 0.49), ("knee", "ankle", 0.49), ("ankle", "toes", 0.2),
    )},
}  # fmt: skip
TRUNK = [BODY.index(name) for name in ("left_shoulder", "right_shoulder", "left_hip", "right_hip")]


def operator_view(pose: Pose3D, hands: tuple[str, ...], person_id: int | None, measured_ns: int) -> OperatorView:
    """The operator in a pose: person `person_id`, or the person who comes first when it is None.

    Args:
        measured_ns: mid-exposure of the newest image in the pose, on the clock of `pose.t_ns`.
    """
    ids = [int(one) for one in pose.person_id]
    n = (0 if ids else None) if person_id is None else ids.index(person_id) if person_id in ids else None
    names = pose.skeleton.keypoints
    if n is None:
        person, xyz, sigma = -1, np.full((len(names), 3), np.nan), np.full(len(names), np.nan)
        views = measured = np.zeros(len(names), np.bool_)
    else:
        person, xyz, sigma = ids[n], pose.xyz_world[n], worst_sigma_m(pose.cov_world[n])
        views, measured = pose.n_views[n], (pose.kind[n] != Kind.MISSING) & (pose.kind[n] != Kind.PREDICTED)
    wrists = [names.index(f"{side}_wrist") for side in hands]
    others = [names.index(f"{'left' if side == 'right' else 'right'}_wrist") for side in hands]
    elbows = [names.index(f"{side}_elbow") for side in hands]
    per_point = np.concatenate([xyz, sigma[:, None], measured[:, None]], axis=-1)
    body = pick_keypoints(per_point, pose.skeleton, BODY)
    return OperatorView(
        t_ns=pose.t_ns,
        measured_ns=measured_ns,
        person_id=person,
        xyz_world=xyz[wrists],
        sigma_m=sigma[wrists],
        views=views[wrists],
        measured=measured[wrists],
        other_xyz_world=xyz[others],
        forearm_m=np.linalg.norm(xyz[wrists] - xyz[elbows], axis=-1),
        body_xyz_world=body[:, :3],
        body_sigma_m=body[:, 3],
        body_measured=body[:, 4] > 0.99,
    )
