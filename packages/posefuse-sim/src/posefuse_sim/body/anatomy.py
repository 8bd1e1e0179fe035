"""Joint centres and segment frames on a body's rest mesh, and joint angles from them: one definition for all bodies.

Joint centres (shoulder, elbow, wrist, hip, knee, ankle) are the fixed convex combinations of mesh vertices around each
joint given by the body model's own anatomical regressor (anny `KeypointsRegressor.coco`), evaluated once on the rest mesh.
The rig's bones turn about these points, not about the rig's bone heads (those lie up to 45 mm away at the hip). So a
joint centre is by construction fixed in both segments that meet there, as the centre of a real ball or hinge joint is.
Nose, eyes, ears, toes and heels are combinations of skin vertices and move with the skin (linear blend skinning).

Segment frames, at rest, in rest axes (x forward, y left, z up); X anterior, Y proximal, Z right:

| segment | origin | axes |
|---|---|---|
| pelvis | middle of the hip centres | the rest mesh's own forward, up, right |
| thorax | middle of the shoulder centres | same, moves with the upper thoracic bone |
| head | middle of the ears | same, moves with the skull |
| thigh, shank | hip, knee | Y: knee -> hip, ankle -> knee; Z: the pelvis's Z made normal to Y |
| foot | ankle | Y up, normal to the sole; X from heel to the middle of big and small toe, level |
| upper arm | shoulder | Y: elbow -> shoulder; Z normal to the plane shoulder-elbow-wrist (the elbow's hinge axis) |
| forearm | elbow | Y: wrist -> elbow; Z across the knuckles: to the thumb on the right, away from it on the left |
| hand | wrist | Y: middle of the knuckles -> wrist; Z as for the forearm |

Joint angles of the body model in the ISB sequences, from its own segment frames.

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

from posefuse.core import SKELETONS
from posefuse.core.arrays import Array

from .mesh import RestMesh

SEGMENTS = ("pelvis", "thorax", "head") + tuple(
    f"{side}_{part}" for side in ("left", "right") for part in ("upper_arm", "forearm", "hand", "thigh", "shank", "foot")
)
_TRUNK = ("flexion", "bend_right", "rotation_left")
_SIDE_JOINTS = {
    "shoulder": ("thorax", "upper_arm", ("plane_of_elevation", "elevation", "internal_rotation")),
    "elbow": ("{}_upper_arm", "forearm", ("flexion", "carrying", "pronation")),
    "wrist": ("{}_forearm", "hand", ("flexion", "ulnar_deviation", "internal_rotation")),
    "hip": ("pelvis", "thigh", ("flexion", "adduction", "internal_rotation")),
    "knee": ("{}_thigh", "shank", ("flexion", "adduction", "internal_rotation")),
    "ankle": ("{}_shank", "foot", ("dorsiflexion", "inversion", "internal_rotation")),
}
# joint -> its proximal and its distal segment, and its angles
_JOINTS = {"trunk": ("pelvis", "thorax", _TRUNK), "neck": ("thorax", "head", _TRUNK)} | {
    f"{side}_{joint}": (proximal.format(side), f"{side}_{distal}", names)
    for side in ("left", "right")
    for joint, (proximal, distal, names) in _SIDE_JOINTS.items()
}
JOINTS = tuple(_JOINTS)
ANGLE_NAMES = tuple(names for _, _, names in _JOINTS.values())
# joints whose flexion turns the distal segment backwards about Z
_FLEXES_BACK = ("trunk", "neck", "left_knee", "right_knee")
_MIRROR = np.array([1.0, 1.0, -1.0])
_DEGENERATE = 1e-7


def joint_segments(joint: str) -> tuple[str, str]:
    """Names of the proximal and the distal segment of a joint."""
    return _JOINTS[joint][:2]


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


def unit_vectors(vector: Array) -> Array:
    """Vectors (..., 3) scaled to length 1."""
    return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True))


def normal_part(vector: Array, along: Array) -> Array:
    """The direction (..., 3) of what vectors have at a right angle to the unit vectors `along`."""
    return unit_vectors(vector - np.sum(vector * along, axis=-1, keepdims=True) * along)


def frame_along(y: Array, towards_z: Array) -> Array:
    """(..., 3, 3) columns X, Y, Z with Y along `y` exactly and Z as near `towards_z` as that allows."""
    y = unit_vectors(y)
    return frame_of(y, normal_part(towards_z, y))


def frame_of(y: Array, z: Array) -> Array:
    """(..., 3, 3) columns X, Y, Z of unit vectors at a right angle."""
    return np.stack([np.cross(y, z), y, z], axis=-1)


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


KEYPOINTS = SKELETONS["anatomical23"]
_FORWARD, _UP, _RIGHT = np.array([1.0, 0, 0]), np.array([0, 0, 1.0]), np.array([0, -1.0, 0])
SIDES = {"left": "L", "right": "R"}
# the bone each segment's frame is fixed to
_SEGMENT_BONE = {
    "upper_arm": "upperarm01", "forearm": "lowerarm02", "hand": "wrist",
    "thigh": "upperleg01", "shank": "lowerleg01", "foot": "foot",
}  # fmt: skip
# joint centre -> the bone on its distal side, which turns about it
_HINGE_BONE = {
    "shoulder": "upperarm01", "elbow": "lowerarm01", "wrist": "wrist", "hip": "upperleg01", "knee": "lowerleg01",
    "ankle": "foot",
}  # fmt: skip


def segment_bone(segment: str) -> str:
    """Name of the bone a segment's frame is fixed to."""
    if segment in ("pelvis", "thorax", "head"):
        return {"pelvis": "root", "thorax": "spine01", "head": "head"}[segment]
    side, part = segment.split("_", 1)
    return f"{_SEGMENT_BONE[part]}.{SIDES[side]}"


def rest_keypoints(mesh: RestMesh) -> dict[str, Array]:
    """Each `ANATOMICAL23` keypoint (3,) on the rest mesh."""
    return dict(zip(KEYPOINTS.keypoints, mesh.keypoint_weight @ mesh.vertices_rest, strict=True))


def turning_centres(mesh: RestMesh) -> Array:
    """(B, 3) rest point each bone turns about: the joint centre where there is one, else the rig's bone head."""
    centre = mesh.bone_head_rest.copy()
    points = rest_keypoints(mesh)
    index = mesh.bone_names.index
    for side, letter in SIDES.items():
        for joint, bone in _HINGE_BONE.items():
            centre[index(f"{bone}.{letter}")] = points[f"{side}_{joint}"]
        # these halves only twist about the line through the joint, so they share its centre
        for half, joint in (("upperarm02", "shoulder"), ("lowerarm02", "elbow"), ("upperleg02", "hip"), ("lowerleg02", "knee")):
            centre[index(f"{half}.{letter}")] = points[f"{side}_{joint}"]
    pelvis = (points["left_hip"] + points["right_hip"]) / 2
    centre[index("root")] = pelvis
    return centre


def keypoint_moments(mesh: RestMesh) -> tuple[Array, Array]:
    """Share (23, B) of each bone in each keypoint and its rest moment (23, B, 3).

    keypoint = sum over bones of rotation_b @ moment_b + share_b * translation_b, with the rigid motion of each bone from rest.
    """
    count = len(mesh.bone_names)
    skin = np.zeros((len(mesh.vertices_rest), count))
    np.add.at(skin, (np.arange(len(skin))[:, None], mesh.bone_index), mesh.bone_weight)
    share = mesh.keypoint_weight @ skin
    moment = np.einsum("kv,vb,vx->kbx", mesh.keypoint_weight, skin, mesh.vertices_rest, optimize=True)
    for k, (name, point) in enumerate(rest_keypoints(mesh).items()):
        side, _, joint = name.partition("_")
        if joint in _HINGE_BONE:
            bone = mesh.bone_names.index(f"{_HINGE_BONE[joint]}.{SIDES[side]}")
            share[k], moment[k] = 0.0, 0.0
            share[k, bone], moment[k, bone] = 1.0, point
    return share, moment


def rest_segment_frames(mesh: RestMesh) -> tuple[Array, Array]:
    """Rest frames of `SEGMENTS`: axes (S, 3, 3) as columns X, Y, Z, and origins (S, 3)."""
    points = rest_keypoints(mesh)
    level = np.stack([_FORWARD, _UP, _RIGHT], axis=1)
    frames = {
        "pelvis": (level, (points["left_hip"] + points["right_hip"]) / 2),
        "thorax": (level, (points["left_shoulder"] + points["right_shoulder"]) / 2),
        "head": (level, (points["left_ear"] + points["right_ear"]) / 2),
    }
    for side in SIDES:
        frames |= {f"{side}_{part}": frame for part, frame in _limb_frames(mesh, points, side).items()}
    return np.stack([frames[s][0] for s in SEGMENTS]), np.stack([frames[s][1] for s in SEGMENTS])


def _limb_frames(mesh: RestMesh, points: dict[str, Array], side: str) -> dict[str, tuple[Array, Array]]:
    at = {name.removeprefix(f"{side}_"): point for name, point in points.items()}
    heads = {b: mesh.bone_head_rest[mesh.bone_names.index(f"{b}.{SIDES[side]}")] for b in ("finger2-1", "finger5-1")}
    thumb_side = heads["finger2-1"] - heads["finger5-1"]
    radial = thumb_side if side == "right" else -thumb_side
    knuckles = (heads["finger2-1"] + heads["finger5-1"]) / 2
    upper, lower = at["elbow"] - at["shoulder"], at["wrist"] - at["elbow"]
    # bending brings the forearm forward: its turn from the upper arm's line has this axis on both sides
    hinge = np.cross(upper, lower)
    sole = (at["big_toe"] + at["small_toe"]) / 2 - at["heel"]
    foot_z = np.cross(sole * [1, 1, 0], _UP)
    return {
        "upper_arm": (frame_along(-upper, hinge), at["shoulder"]),
        "forearm": (frame_along(-lower, radial), at["elbow"]),
        "hand": (frame_along(at["wrist"] - knuckles, radial), at["wrist"]),
        "thigh": (frame_along(at["hip"] - at["knee"], _RIGHT), at["hip"]),
        "shank": (frame_along(at["knee"] - at["ankle"], _RIGHT), at["knee"]),
        "foot": (frame_along(_UP, foot_z), at["ankle"]),
    }
