"""A first state of a body, straight from where its keypoints are."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array
from posefuse.kinematics.definitions import SEGMENT_NAMES
from posefuse.kinematics.joints import FrameBuffers

from . import kernels
from .model import BodyModel
from .packed import Packed
from .tree import BALL, NODE_SEGMENT

# the joint to which a limb is attached -> the one at which its first segment ends
_FIRST_SEGMENTS = (("shoulder", "elbow"), ("hip", "knee"))
_LIMBS = {f"{side}_{upper}": f"{side}_{lower}" for side in ("left", "right") for upper, lower in _FIRST_SEGMENTS}


def guessed_state(body: BodyModel, packed: Packed, workspace: FrameBuffers, xyz: Array) -> tuple[Array, Array] | None:
    """State (nodes,), (nodes, 3, 3) of a body whose keypoints (A, 3) are at these places; None without a pelvis.

    Joint angles come from the segment frames of the points. A straight limb has no frame: its first segment then points along
    the limb, turned from its parent by the smallest angle, and its hinge is straight.
    """
    points = np.full((len(body.skeleton), 3), np.nan)
    points[body.keypoint] = xyz
    rotation = workspace.frames_alone(points)
    if np.isnan(rotation[SEGMENT_NAMES.index("pelvis")]).any():
        return None
    hips = [body.skeleton.index(f"{side}_hip") for side in ("left", "right")]
    q, rot = np.zeros(len(body.nodes)), np.tile(np.eye(3), (len(body.nodes), 1, 1))
    q[:3] = points[hips].mean(axis=0)
    frame, origin = np.empty_like(rot), np.empty((len(rot), 3))
    for n, node in enumerate(body.nodes):
        kernels.forward_kinematics(
            packed.tree.parent, packed.tree.kind, packed.tree.axis, packed.tree.offset, q, rot, frame, origin
        )
        segment = NODE_SEGMENT.get(node.name)
        if segment is None:
            continue
        world = rotation[SEGMENT_NAMES.index(segment)]
        if not np.isnan(world).any():
            relative = frame[n].T @ world
            if node.kind == BALL:
                rot[n] = relative
            elif node.axis == 2:
                q[n] = np.arctan2(-relative[0, 1], relative[1, 1])
        elif _LIMBS.get(node.name) in body.skeleton.keypoints:
            along = points[body.skeleton.index(_LIMBS[node.name])] - points[body.skeleton.index(node.name)]
            if np.isfinite(along).all() and along.any():
                rot[n] = _shortest(np.array([0.0, -1.0, 0.0]), frame[n].T @ along / np.linalg.norm(along))
    return q, rot


def _shortest(one: Array, other: Array) -> Array:
    """Rotation (3, 3) by the smallest angle that takes one unit vector to another; about X where they are opposite."""
    axis, cosine = np.cross(one, other), float(one @ other)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-9:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    return np.asarray(kernels.exp3(axis / sine * np.arctan2(sine, cosine)))
