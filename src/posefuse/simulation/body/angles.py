"""Joint angles of the body model in the ISB sequences, from its own segment frames.

Segment axes: X anterior, Y proximal (up), Z to the subject's right, on both sides of the body (Wu & Cavanagh 1995;
Wu et al. 2002, 2005). A joint's rotation is proximal_from_distal. On the left it is mirrored about the sagittal plane
first, so that a motion and its mirror image give the same numbers.

- Hip, knee, ankle, elbow, wrist, trunk, neck: Z, then X, then Y of the moved axes (Cardan ZXY).
- Shoulder: Y, X, Y (humerus in the thorax): plane of elevation (0 = abduction, +90 deg = forward), elevation >= 0,
  internal rotation. Where the arm points exactly down the plane is taken as 0.

Signs, both sides: flexion, ankle dorsiflexion, adduction, ankle inversion, internal rotation, forearm pronation and ulnar
deviation are positive; trunk and neck: forward flexion, bending to the right and turning to the left are positive.
"""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array

SEGMENTS = ("pelvis", "thorax", "head") + tuple(
    f"{side}_{part}" for side in ("left", "right") for part in ("upper_arm", "forearm", "hand", "thigh", "shank", "foot")
)
_TRUNK = ("flexion", "bend_right", "rotation_left")
_SIDE_JOINTS = {
    "shoulder": ("thorax", "upper_arm", ("plane_of_elevation", "elevation", "internal_rotation")),
    "elbow": ("upper_arm", "forearm", ("flexion", "carrying", "pronation")),
    "wrist": ("forearm", "hand", ("flexion", "ulnar_deviation", "internal_rotation")),
    "hip": ("pelvis", "thigh", ("flexion", "adduction", "internal_rotation")),
    "knee": ("thigh", "shank", ("flexion", "adduction", "internal_rotation")),
    "ankle": ("shank", "foot", ("dorsiflexion", "inversion", "internal_rotation")),
}
JOINTS = ("trunk", "neck") + tuple(f"{side}_{joint}" for side in ("left", "right") for joint in _SIDE_JOINTS)
ANGLE_NAMES = (_TRUNK, _TRUNK) + tuple(names for _ in range(2) for _, _, names in _SIDE_JOINTS.values())
# joints whose flexion turns the distal segment backwards about Z
_FLEXES_BACK = ("trunk", "neck", "left_knee", "right_knee")
_MIRROR = np.array([1.0, 1.0, -1.0])
_DEGENERATE = 1e-7


def joint_segments(joint: str) -> tuple[str, str]:
    """Names of the proximal and the distal segment of a joint."""
    if joint == "trunk":
        return "pelvis", "thorax"
    if joint == "neck":
        return "thorax", "head"
    side, part = joint.split("_")
    proximal, distal, _ = _SIDE_JOINTS[part]
    return (proximal if proximal in ("pelvis", "thorax") else f"{side}_{proximal}"), f"{side}_{distal}"


def joint_angles_from_rotations(rotation_world: Array) -> Array:
    """Angles (..., J, 3) in radians of `JOINTS` from segment rotations world_from_segment (..., S, 3, 3)."""
    columns = []
    for joint in JOINTS:
        proximal, distal = (rotation_world[..., SEGMENTS.index(name), :, :] for name in joint_segments(joint))
        columns.append(angles_of(joint, np.swapaxes(proximal, -1, -2) @ distal))
    return np.stack(columns, axis=-2)


def angles_of(joint: str, proximal_from_distal: Array) -> Array:
    """Angles (..., 3) in radians of one joint from its rotation matrix (..., 3, 3)."""
    r = _mirrored(joint, proximal_from_distal)
    angles = _yxy(r) if joint.endswith("shoulder") else _zxy(r)
    if joint in _FLEXES_BACK:
        angles = angles * np.array([-1.0, 1.0, 1.0])
    return angles


def rotation_of(joint: str, angles_rad: Array) -> Array:
    """Rotation matrices proximal_from_distal (..., 3, 3) of one joint's angles (..., 3): the inverse of `angles_of`."""
    a, b, c = np.moveaxis(np.asarray(angles_rad, np.float64), -1, 0)
    if joint.endswith("shoulder"):
        r = turn("y", a) @ turn("x", -b) @ turn("y", c)
    else:
        r = turn("z", -a if joint in _FLEXES_BACK else a) @ turn("x", b) @ turn("y", c)
    return _mirrored(joint, r)


def turn(axis: str, angle_rad: Array) -> Array:
    """Rotation matrices (..., 3, 3) about one coordinate axis (``x``, ``y``, ``z``)."""
    angle = np.asarray(angle_rad, np.float64)
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    out = np.zeros((*angle.shape, 3, 3))
    out[..., 3 - i - j, 3 - i - j] = 1.0
    out[..., i, i] = out[..., j, j] = np.cos(angle)
    out[..., j, i] = np.sin(angle)
    out[..., i, j] = -np.sin(angle)
    return out


def _mirrored(joint: str, r: Array) -> Array:
    return r * _MIRROR[:, None] * _MIRROR if joint.startswith("left_") else r


def _zxy(r: Array) -> Array:
    return np.stack(
        [
            np.arctan2(-r[..., 0, 1], r[..., 1, 1]),
            np.arcsin(np.clip(r[..., 2, 1], -1, 1)),
            np.arctan2(-r[..., 2, 0], r[..., 2, 2]),
        ],
        axis=-1,
    )


def _yxy(r: Array) -> Array:
    sine = np.hypot(r[..., 0, 1], r[..., 2, 1])
    hangs = sine < _DEGENERATE
    plane = np.where(hangs, 0.0, np.arctan2(-r[..., 0, 1], -r[..., 2, 1]))
    inner = np.where(hangs, np.arctan2(r[..., 0, 2], r[..., 0, 0]), np.arctan2(-r[..., 1, 0], r[..., 1, 2]))
    return np.stack([plane, np.arctan2(sine, r[..., 1, 1]), inner], axis=-1)
