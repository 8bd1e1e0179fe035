"""A figure posed by given angles with scipy's rotations: a way to the keypoints that shares no code with the room."""

from collections.abc import Callable

import numpy as np
from built import poses
from scipy.spatial.transform import Rotation

from posefuse.core import SKELETONS, PoseSequence
from posefuse.kinematics.definitions import NOSE_BELOW_RAD

LENGTH_M = {
    "pelvis": 0.13, "trunk": 0.52, "shoulder": 0.19, "upper_arm": 0.31, "forearm": 0.26, "hand": 0.09,
    "thigh": 0.43, "shank": 0.41,
}  # fmt: skip
# degrees of every joint, no two alike
BENT = {
    "pelvis": (20.0, 5.0, 12.0), "trunk": (0.0, 8.0, -15.0), "neck": (14.0, -6.0, 25.0), "left_arm": (35.0, -22.0, 18.0),
    "right_arm": (-25.0, -40.0, 30.0), "left_elbow": (75.0, 0.0, 0.0), "right_elbow": (48.0, 0.0, 0.0),
    "left_wrist": (35.0, 20.0, -12.0), "right_wrist": (60.0, -25.0, 9.0), "left_hip": (40.0, 11.0, -9.0),
    "right_hip": (-15.0, -8.0, 14.0), "left_knee": (62.0, 0.0, 0.0), "right_knee": (31.0, 0.0, 0.0),
    "left_ankle": (-18.0, 7.0, 5.0), "right_ankle": (12.0, -9.0, -6.0),
}  # fmt: skip
GROUND = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def _turn(sequence: str, *degrees: float) -> np.ndarray:
    return Rotation.from_euler(sequence, degrees, degrees=True).as_matrix()


def _mirror(side: str, rotation: np.ndarray) -> np.ndarray:
    flip = np.diag([1.0, 1.0, -1.0]) if side == "left" else np.eye(3)
    return flip @ rotation @ flip


def walking(t_s: float) -> dict[str, tuple[float, float, float]]:
    """Angles of a person who walks a stride a second, turning about slowly."""
    w, v = np.sin(2 * np.pi * t_s), np.cos(2 * np.pi * t_s)
    return {
        "pelvis": (15 * t_s, 3 * w, 5), "trunk": (0, 2 * w, 5 * v), "neck": (10, 3, 5 * w), "left_hip": (25 * w, 3, 5),
        "right_hip": (-25 * w, 3, 5), "left_knee": (35 - 25 * v, 0, 0), "right_knee": (35 + 25 * v, 0, 0),
        "left_arm": (-25 * w, -8, 10), "right_arm": (25 * w, -8, 10), "left_elbow": (40 + 10 * w, 0, 0),
        "right_elbow": (30, 0, 0), "left_ankle": (10 * w, 2, 2), "right_ankle": (-10 * w, 2, 3),
        "left_wrist": (30 + 20 * w, 5, 2),
    }  # fmt: skip


def figure(angles: dict[str, tuple[float, float, float]], root: np.ndarray | None = None) -> dict[str, np.ndarray]:
    """Landmarks (3,) of a standing figure with these joint angles in degrees, in the room's names, sequences and signs."""

    def angle(name: str) -> tuple[float, float, float]:
        return angles.get(name, (0.0, 0.0, 0.0))

    rotation, left, up = angle("pelvis")
    pelvis = (np.eye(3) if root is None else root) @ GROUND @ _turn("YXZ", rotation, left, -up)
    hips = np.array([0.3, -0.7, 0.95])
    _, bend, twist = angle("trunk")
    thorax = pelvis @ _turn("ZXY", 0, bend, twist)
    neck = hips + thorax @ [0, LENGTH_M["trunk"], 0]
    flexion, bend, twist = angle("neck")
    head = thorax @ _turn("ZXY", -flexion, bend, twist)
    ears = neck + thorax @ [0.02, 0.17, 0]
    points = {"nose": ears + 0.1 * head @ [np.cos(NOSE_BELOW_RAD), -np.sin(NOSE_BELOW_RAD), 0]}
    for side, z in (("left", -1), ("right", 1)):
        points[f"{side}_ear"] = ears + head @ [0, 0, z * 0.075]
        _leg(points, side, hips + pelvis @ [0, 0, z * LENGTH_M["pelvis"]], pelvis, angle)
        _arm(points, side, neck + thorax @ [0, 0, z * LENGTH_M["shoulder"]], thorax, angle)
    return points


def _leg(points: dict, side: str, hip: np.ndarray, pelvis: np.ndarray, angle: Callable) -> None:
    thigh = pelvis @ _mirror(side, _turn("ZXY", *angle(f"{side}_hip")))
    shank = thigh @ _turn("Z", -angle(f"{side}_knee")[0])
    foot = shank @ _mirror(side, _turn("ZXY", *angle(f"{side}_ankle")))
    knee = hip - thigh @ [0, LENGTH_M["thigh"], 0]
    ankle = knee - shank @ [0, LENGTH_M["shank"], 0]
    heel = ankle + foot @ [-0.05, -0.06, 0]
    points |= {f"{side}_hip": hip, f"{side}_knee": knee, f"{side}_ankle": ankle, f"{side}_heel": heel}
    points[f"{side}_big_toe"] = points[f"{side}_small_toe"] = points[f"{side}_foot_index"] = heel + foot @ [0.22, 0, 0]


def _arm(points: dict, side: str, shoulder: np.ndarray, thorax: np.ndarray, angle: Callable) -> None:
    upper = thorax @ _mirror(side, _turn("ZXY", *angle(f"{side}_arm")))
    fore = upper @ _turn("Z", angle(f"{side}_elbow")[0])
    hand = fore @ _mirror(side, _turn("YZX", *angle(f"{side}_wrist")))
    elbow = shoulder - upper @ [0, LENGTH_M["upper_arm"], 0]
    wrist = elbow - fore @ [0, LENGTH_M["forearm"], 0]
    across = hand @ [0, 0, 0.035 if side == "right" else -0.035]
    knuckles = wrist - hand @ [0, LENGTH_M["hand"], 0]
    points |= {f"{side}_shoulder": shoulder, f"{side}_elbow": elbow, f"{side}_wrist": wrist}
    points |= {f"{side}_index": knuckles + across, f"{side}_pinky": knuckles - across}


def sequence_of(
    frames: list[dict],
    skeleton: str = "blazepose33",
    sigma_m: float = 1e-6,
    rate_hz: float = 100.0,
    root: np.ndarray | None = None,
) -> PoseSequence:
    """Out of one dict of angles per time step."""
    made = SKELETONS[skeleton]
    xyz = np.full((len(frames), 1, len(made), 3), np.nan)
    for i, angles in enumerate(frames):
        for name, point in figure(angles, root).items():
            if name in made.keypoints:
                xyz[i, 0, made.index(name)] = point
    return poses(xyz, sigma_m, rate_hz, made)
