"""Bodies as ROS for Human-Robot Interaction wants them (REP-155): link frames and joint positions of its human model.

Axes of every link: x forward, y to the subject's left, z up while standing with hanging arms (REP-103). The joints are
those of the reference URDF (package `human_description`):

- shoulder ``Rz(-s y) Rx(s p) Rz(s r)``, hip ``Rz(-y) Rx(s p) Ry(-r)``, s = 1 left, -1 right; head ``Rx(r) Rz(y) Ry(-p)``;
- elbow and knee turn about -y: flexing an elbow is positive, flexing a knee negative.

Hip centres do not show how the pelvis is tilted about the line through them: the body's z points to the middle of the
shoulders and the joint ``waist`` is 0. Limbs are expressed in the body frame, so their directions come out of that URDF
as they were measured. A straight limb shows no plane to turn in; within 10 degrees of straight its plane goes over
smoothly to the one it has when the limb is swung there from hanging, without twist.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import SE3, Pose3D
from posefuse.core.arrays import Array
from posefuse.core.se3 import quaternion_product
from posefuse.core.skeleton import SIDES, pick_keypoints

LINKS = (
    "body", "torso", "head", "l_shoulder", "r_shoulder", "l_elbow", "r_elbow", "l_wrist", "r_wrist",
    "l_hip", "r_hip", "l_knee", "r_knee", "l_ankle", "r_ankle",
)  # fmt: skip
JOINTS = (
    "waist", "r_head", "y_head", "p_head",
    "l_y_shoulder", "r_y_shoulder", "l_p_shoulder", "r_p_shoulder", "l_r_shoulder", "r_r_shoulder", "l_elbow", "r_elbow",
    "l_y_hip", "r_y_hip", "l_p_hip", "r_p_hip", "l_r_hip", "r_r_hip", "l_knee", "r_knee",
)  # fmt: skip
_STRAIGHT = float(np.sin(np.deg2rad(10.0)))
# parts that there are two of, in the order of `POINTS`
ENDS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "ear")
# keypoints that a body is made of
POINTS = tuple(f"{side}_{part}" for part in ENDS for side in SIDES) + ("nose",)
# +1 left, -1 right: the URDF's `reflect`
_SIDE = np.array([1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Bodies:
    """People at one time step as the REP-155 human model.

    Attributes:
        world_from_link: batch (N, L), links in the order of `LINKS`; NaN where not seen.
        position_rad: (N, J) in the order of `JOINTS`; NaN where not seen.
    """

    world_from_link: SE3
    position_rad: Array


def bodies_from_pose(pose: Pose3D) -> Bodies:
    """Links and joints of everybody; a person whose hips or shoulders are missing has none."""
    upper = _upper_body(pick_keypoints(pose.xyz_world, pose.skeleton, POINTS))
    at, middle, body, forearm = upper.at, upper.middle, upper.body, upper.forearm
    torso = _axes(y=at["shoulder"][:, 0] - at["shoulder"][:, 1], z=upper.spine)
    thigh, knee = _limb(body, at["hip"], at["knee"], at["ankle"], -1.0)
    trunk = body[:, None]
    shank = trunk @ _about_y(thigh, -knee)
    rotation = np.concatenate(
        [np.stack([body, torso, upper.head], axis=1), trunk @ upper.upper_arm, forearm, forearm, trunk @ thigh, shank, shank],
        axis=1,
    )
    xyz = np.concatenate(
        [np.stack([middle["hip"], middle["shoulder"], middle["ear"]], axis=1)] + [at[part] for part in ENDS[:-1]], axis=1
    )
    links = _links(body, rotation, xyz)
    seen = np.isfinite(links.xyz[..., :1])
    angles = [
        np.where(np.isfinite(upper.spine[:, :1]), 0.0, np.nan),
        np.where(seen[:, 2], _head_angles(body, upper.head), np.nan),
    ]
    angles += [*_shoulder_angles(upper.upper_arm), upper.elbow, *_hip_angles(thigh), knee]
    return Bodies(links, np.where(seen[:, 0], np.concatenate(angles, axis=1), np.nan))


def head_and_wrists(points: Array) -> SE3:
    """The links head, l_wrist and r_wrist alone (N, 3) from keypoints (N, len(POINTS), 3) in the order of `POINTS`."""
    upper = _upper_body(points)
    rotation = np.concatenate([upper.head[:, None], upper.forearm], axis=1)
    return _links(upper.body, rotation, np.concatenate([upper.middle["ear"][:, None], upper.at["wrist"]], axis=1))


@dataclass(frozen=True, eq=False)
class _UpperBody:
    """Keypoints (N, 2, 3) and their middles (N, 3) by part, and frames; upper arms in body axes, all others in the world's."""

    at: dict[str, Array]
    middle: dict[str, Array]
    spine: Array
    body: Array
    head: Array
    upper_arm: Array
    forearm: Array
    elbow: Array


def _upper_body(points: Array) -> _UpperBody:
    at = {part: points[:, 2 * i : 2 * i + 2] for i, part in enumerate(ENDS)}
    middle = {part: at[part].mean(axis=1) for part in ("hip", "shoulder", "ear")}
    spine = middle["shoulder"] - middle["hip"]
    body = _axes(y=at["hip"][:, 0] - at["hip"][:, 1], z=spine)
    head = _head_axes(at["ear"][:, 0] - at["ear"][:, 1], points[:, -1] - middle["ear"])
    upper_arm, elbow = _limb(body, at["shoulder"], at["elbow"], at["wrist"], 1.0)
    forearm = body[:, None] @ _about_y(upper_arm, -elbow)
    return _UpperBody(at=at, middle=middle, spine=spine, body=body, head=head, upper_arm=upper_arm, forearm=forearm, elbow=elbow)


def _links(body: Array, rotation: Array, xyz: Array) -> SE3:
    """Batch (N, L); NaN where a link is not seen, or the body is not."""
    whole = np.asarray(np.isfinite(body).all(axis=(-1, -2)))
    seen = np.asarray(np.isfinite(rotation).all(axis=(-1, -2)) & np.isfinite(xyz).all(axis=-1) & whole[:, None])
    return SE3.from_matrix(np.where(seen[..., None, None], rotation, np.nan), np.where(seen[..., None], xyz, np.nan))


def unit_or_nan(vectors: Array) -> Array:
    """(..., 3) of length one; NaN where there is no length."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 1e-9, length, np.nan))


def _axes(y: Array, z: Array) -> Array:
    """(N, 3, 3) columns x, y, z: z along the given z, y as near to the given y as a right angle to z allows."""
    up = unit_or_nan(z)
    forward = unit_or_nan(np.cross(y, up))
    return np.stack([forward, np.cross(up, forward), up], axis=-1)


def _head_axes(left: Array, nose: Array) -> Array:
    """(N, 3, 3): y along the ears, x towards the nose."""
    y = unit_or_nan(left)
    x = unit_or_nan(nose - (nose * y).sum(axis=-1, keepdims=True) * y)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def _limb(body: Array, near: Array, middle: Array, far: Array, bends: float) -> tuple[Array, Array]:
    """Frames (N, 2, 3, 3) of left and right upper segments in body axes, z pointing up the limb, and joint angles (N, 2).

    `bends` is 1 where the lower segment swings forward (elbow), -1 where it swings back (knee).
    """
    u, v = unit_or_nan((middle - near) @ body), unit_or_nan((far - middle) @ body)
    along = (u * v).sum(axis=-1, keepdims=True)
    across = bends * (v - along * u)
    sine = np.linalg.norm(across, axis=-1, keepdims=True)
    x = unit_or_nan(across + _untwisted_forward(u) * np.maximum(0.0, _STRAIGHT - sine))
    frame = np.stack([x, np.cross(-u, x), -u], axis=-1)
    return frame, bends * np.arctan2(sine, along)[..., 0]


def _untwisted_forward(u: Array) -> Array:
    """Where the body's x goes when a hanging limb is swung by the shortest way into direction u."""
    # first column of Rodrigues' rotation from -z to u; straight up it is the limit of swinging through the front
    x, y, z = u[..., 0], u[..., 1], u[..., 2]
    scale = 1 / np.maximum(1 - z, 1e-9)
    return np.stack([1 - x * x * scale, -x * y * scale, x], axis=-1)


def _about_y(frame: Array, angle_rad: Array) -> Array:
    """`frame` (..., 3, 3) turned about its own y."""
    c, s = np.cos(angle_rad)[..., None], np.sin(angle_rad)[..., None]
    x, y, z = frame[..., 0], frame[..., 1], frame[..., 2]
    return np.stack([c * x - s * z, y, s * x + c * z], axis=-1)


def _shoulder_angles(m: Array) -> list[Array]:
    """y, p, r (N, 2) each of m = Rz(-s y) Rx(s p) Rz(s r), p >= 0; y = 0 where only their sum is defined."""
    sine = np.hypot(m[..., 0, 2], m[..., 1, 2])
    hanging = sine < 1e-9
    yaw = np.where(hanging, 0.0, np.arctan2(_SIDE * m[..., 0, 2], -_SIDE * m[..., 1, 2]))
    roll = np.where(hanging, np.arctan2(m[..., 1, 0], m[..., 0, 0]), np.arctan2(_SIDE * m[..., 2, 0], _SIDE * m[..., 2, 1]))
    return [-_SIDE * yaw, np.arctan2(sine, m[..., 2, 2]), _SIDE * roll]


def _hip_angles(m: Array) -> list[Array]:
    """y, p, r (N, 2) each of m = Rz(-y) Rx(s p) Ry(-r)."""
    pitch = np.arcsin(np.clip(m[..., 2, 1], -1, 1))
    return [np.arctan2(m[..., 0, 1], m[..., 1, 1]), _SIDE * pitch, np.arctan2(m[..., 2, 0], m[..., 2, 2])]


def _head_angles(body: Array, head: Array) -> Array:
    """r, y, p (N, 3) of body_from_head = Rx(r) Rz(y) Ry(-p)."""
    m = np.swapaxes(body, -1, -2) @ head
    yaw = np.arcsin(np.clip(-m[..., 0, 1], -1, 1))
    return np.stack([np.arctan2(m[..., 2, 1], m[..., 1, 1]), yaw, -np.arctan2(m[..., 0, 2], m[..., 0, 0])], axis=-1)


PARTS = ("head", "left_wrist", "right_wrist", "left_hand", "right_hand")
_HANDS = ("left_index", "right_index", "left_pinky", "right_pinky")
_NAMES = (*POINTS, *_HANDS)
_FROM_BODY = [LINKS.index(name) for name in ("head", "l_wrist", "r_wrist")]
_WRISTS = tuple(POINTS.index(f"{side}_wrist") for side in SIDES)
# legs do not move a part
_MOVING = [i for i, name in enumerate(_NAMES) if not name.endswith(("_knee", "_ankle"))]
_STEP_M = 1e-4
# (m, 3, k, 3): every coordinate of every point that moves a part moved a little
_MOVED_M = _STEP_M * np.eye(3 * len(_NAMES)).reshape(len(_NAMES), 3, len(_NAMES), 3)[_MOVING]
# what rounding alone makes, in metres or rad per metre, is far below
_NO_SLOPE = 1e-9


def parts_from_pose(pose: Pose3D, bodies: Bodies) -> SE3:
    """World from part, batch (N, P) in the order of `PARTS`, NaN where not seen; `bodies` are those of the pose."""
    return _parts(bodies.world_from_link[:, _FROM_BODY], pick_keypoints(pose.xyz_world, pose.skeleton, _NAMES))


def covariance_of_parts(pose: Pose3D, parts: SE3) -> Array:
    """(N, P, 6, 6) of x, y, z in metres and of a small turn about the world's x, y, z in rad; `parts` are those of the pose.

    Errors of keypoints are taken as independent; the covariance is exact to first order.
    """
    points = pick_keypoints(pose.xyz_world, pose.skeleton, _NAMES)
    n, m = len(points), len(_MOVING)
    flat = pose.cov_world.reshape(*pose.cov_world.shape[:2], 9)
    cov = pick_keypoints(flat, pose.skeleton, _NAMES)[:, _MOVING].reshape(n, m, 3, 3)
    # all in one batch
    moved = (points[:, None, None] + _MOVED_M).reshape(-1, *points.shape[1:])
    found = _parts(head_and_wrists(moved[:, : len(POINTS)]), moved)
    shape = (n, 3 * m, len(PARTS))
    wxyz, xyz = found.wxyz.reshape(*shape, 4), found.xyz.reshape(*shape, 3)
    away = np.concatenate([xyz - parts.xyz[:, None], small_turn(wxyz, parts.wxyz[:, None])], axis=-1) / _STEP_M
    slope = np.moveaxis(away.reshape(n, m, 3, len(PARTS), 6), 3, 1)
    # a point a part does not depend on may be missing
    counts = np.asarray((np.abs(slope) > _NO_SLOPE).any(axis=(-1, -2)))
    terms = np.einsum("npmai,nmab,npmbj->npmij", slope, cov, slope)
    total = np.where(counts[..., None, None], terms, 0.0).sum(axis=2)
    known = np.asarray(np.isfinite(parts.xyz).all(axis=-1))[..., None, None]
    return np.where(known, (total + np.swapaxes(total, -1, -2)) / 2, np.nan)


def _parts(links: SE3, points: Array) -> SE3:
    """Batch (N, P) from the links that are parts, and points (N, len(_NAMES), 3)."""
    knuckles = points[:, len(POINTS) :].reshape(-1, 2, 2, 3)
    index, pinky = knuckles[:, 0], knuckles[:, 1]
    middle = (index + pinky) / 2
    x = unit_or_nan(middle - points[:, list(_WRISTS)])
    # with the palm down the thumb is on the right of a left hand, and on the left of a right one
    left = (pinky - index) * np.array([1.0, -1.0])[:, None]
    z = unit_or_nan(np.cross(x, left))
    rotation = np.stack([x, np.cross(z, x), z], axis=-1)
    seen = np.asarray(np.isfinite(rotation).all(axis=(-1, -2)) & np.isfinite(middle).all(axis=-1))
    hands = SE3.from_matrix(np.where(seen[..., None, None], rotation, np.nan), np.where(seen[..., None], middle, np.nan))
    return SE3(np.concatenate([links.wxyz, hands.wxyz], axis=1), np.concatenate([links.xyz, hands.xyz], axis=1))


def small_turn(wxyz: Array, from_wxyz: Array) -> Array:
    """(..., 3) rotation vector of a small turn, world axes."""
    back = np.broadcast_to(from_wxyz, wxyz.shape) * np.array([1.0, -1.0, -1.0, -1.0])
    small = quaternion_product(wxyz, back)
    return np.asarray(2.0 * small[..., 1:] * np.sign(small[..., :1]))
