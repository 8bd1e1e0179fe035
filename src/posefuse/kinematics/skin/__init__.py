"""A person as a skinned mesh of their own proportions: for eyes, not for measuring."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.core.skeleton import LIMB_ENDS, SIDES
from posefuse.formats.bvh import BvhData
from posefuse.formats.gltf import Skin
from posefuse.kinematics.animation import FILE_FROM_SEGMENT, PARENT
from posefuse.kinematics.definitions import LIMBS, SEGMENT_NAMES, Limb
from posefuse.kinematics.joints import FrameBuffers

# The mesh that people are drawn as: a mean body and its shapes (`tools/make_body_mesh.py`; NOTICE has the licences).

# a length that the skeleton has counts as much as a shape of one standard deviation if it is this far off
_LENGTH_SIGMA_M = 0.003


@dataclass(frozen=True, eq=False, kw_only=True)
class Template:
    """A standing body, arms held away from it; metres, facing +X, left +Y, up +Z.

    Attributes:
        segments: S names. weights: (V, S) of each vertex; rows sum to 1. faces: (F, 3).
        vertices, vertex_shapes: (V, 3) of the mean body, (N, V, 3) by how much a shape of size 1 moves them.
        points, point_shapes: the same of keypoints, by name.
    """

    segments: tuple[str, ...]
    weights: Array
    faces: Array
    vertices: Array
    vertex_shapes: Array
    points: Mapping[str, Array]
    point_shapes: Mapping[str, Array]

    def points_of(self, shape: Array) -> dict[str, Array]:
        """Keypoints (3,) of a body of shape (N,)."""
        return {name: mean + shape @ self.point_shapes[name] for name, mean in self.points.items()}

    def shape_of(self, lengths_m: Mapping[str, float]) -> Array:
        """(N,) the likeliest shape of a body with these lengths (`length_names`); unknown ones are left out.

        The mesh of a simulated child of 6 then lies 10 mm from its skin; the mean body stretched to its lengths, 26 mm.
        """
        names = [name for name in length_names() if name in lengths_m]
        wanted = np.array([lengths_m[name] for name in names])

        def misfit(shape: Array) -> Array:
            return np.concatenate([(self._lengths(names, shape) - wanted) / _LENGTH_SIGMA_M, shape])

        return np.asarray(least_squares(misfit, np.zeros(len(self.vertex_shapes))).x)

    def _lengths(self, names: list[str], shape: Array) -> Array:
        points = self.points_of(shape)
        return np.array([np.linalg.norm(points[a] - points[b]) for a, b in (length_names()[name] for name in names)])


@cache
def length_names() -> dict[str, tuple[str, str]]:
    """Name of a length -> the keypoints it is between."""
    found = {f"{side}_{name}": (f"{side}_{a}", f"{side}_{b}") for side in SIDES for name, (a, b) in LIMB_ENDS.items()}
    return {**found, "shoulders": ("left_shoulder", "right_shoulder"), "hips": ("left_hip", "right_hip")}


@cache
def template() -> Template:
    """The body of the package."""
    with np.load(Path(__file__).with_name("body.npz")) as file:
        mean, shapes, weights = file["mean_m"].astype(float), file["shapes_m"].astype(float), file["weights"].astype(float)
        count = len(weights)
        names = file["points"].tolist()
        return Template(
            segments=tuple(file["segments"].tolist()),
            weights=weights / weights.sum(axis=1, keepdims=True),
            faces=file["faces"].astype(int),
            vertices=mean[:count],
            vertex_shapes=shapes[:, :count],
            points=dict(zip(names, mean[count:], strict=True)),
            point_shapes={name: shapes[:, count + i] for i, name in enumerate(names)},
        )


_RIGHT = np.array([0, -1.0, 0])
_NEXT = {"upper_arm": "forearm", "forearm": "hand", "thigh": "shank", "shank": "foot"}
_MOST_JOINTS = 4


def skin_of(skeleton: BvhData) -> Skin:
    """A mesh of the likeliest body with this skeleton's lengths (`kinematics.animation.animation_from_joints`)."""
    body = template()
    rest = dict(zip(skeleton.names, skeleton.rest_positions(), strict=True))
    shape = body.shape_of(_lengths(rest))
    index = {name: j for j, name in enumerate(skeleton.names)}
    weight = np.zeros((len(body.weights), len(skeleton.names)))
    for s, name in enumerate(body.segments):
        weight[:, index[_carrier(name, rest)]] += body.weights[:, s]
    joint = np.argsort(-weight, axis=1, kind="stable")[:, :_MOST_JOINTS]
    kept = np.take_along_axis(weight, joint, axis=1)
    matrices = np.tile(np.eye(4), (len(skeleton.names), 1, 1))
    for name, matrix in _bound(body.points_of(shape)).items():
        if name in index:
            matrices[index[name]] = matrix
    return Skin(
        vertices=body.vertices + np.tensordot(shape, body.vertex_shapes, 1),
        faces=body.faces,
        joint=np.where(kept > 0, joint, 0),
        weight=kept / kept.sum(axis=1, keepdims=True),
        joint_from_mesh=matrices,
    )


def _lengths(rest: Mapping[str, Array]) -> dict[str, float]:
    spans = {f"{s}_{name}": (f"{s}_{name}", _end(f"{s}_{_NEXT[name]}", rest)) for s in SIDES for name in _NEXT}
    spans |= {"shoulders": ("left_upper_arm", "right_upper_arm"), "hips": ("left_thigh", "right_thigh")}
    known = {name: (a, b) for name, (a, b) in spans.items() if a in rest and b in rest}
    return {name: float(np.linalg.norm(rest[a] - rest[b])) for name, (a, b) in known.items()}


def _end(segment: str, rest: Mapping[str, Array]) -> str:
    """The joint that begins a segment; of a skeleton without it, the end of the segment before."""
    return segment if segment in rest else f"{PARENT[segment]}_end"


def _carrier(segment: str, rest: Mapping[str, Array]) -> str:
    while segment not in rest and segment != "pelvis":
        segment = PARENT[segment]
    return segment


def _bound(points: Mapping[str, Array]) -> dict[str, Array]:
    """By segment, (4, 4) from the template to the axes of a joint whose segment lies along the axes of the file at rest."""
    work = FrameBuffers(Skeleton("template", tuple(points)))
    xyz = np.array(list(points.values()))
    work.read(xyz, np.zeros((*xyz.shape, 3)))
    work.solve(np.array([[*_normal(limb, points), 0.0, np.inf, 0.0] for limb in LIMBS]))
    origins = dict(zip(SEGMENT_NAMES, work.origins(), strict=True))
    # the line from mid-hip to neck is rigid, so it turns about the hips
    origins["thorax"] = origins["pelvis"]
    bound = {}
    for segment, axes in zip(SEGMENT_NAMES, work.rotation, strict=True):
        bound[segment] = np.eye(4)
        bound[segment][:3, :3] = FILE_FROM_SEGMENT @ axes.T
        bound[segment][:3, 3] = -bound[segment][:3, :3] @ origins[segment]
    return bound


def _normal(limb: Limb, points: Mapping[str, Array]) -> Array:
    """(3,) of the plane in which a limb of the template bends: legs are straight, arms are not."""
    if limb.name.endswith("leg"):
        return _RIGHT
    return np.cross(points[limb.distal] - points[limb.middle], points[limb.proximal] - points[limb.middle])
