"""The mesh that people are drawn as: a mean body and its shapes (`tools/make_body_mesh.py`; NOTICE has the licences)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from posefuse.core.arrays import Array

# a length that the skeleton has counts as much as a shape of one standard deviation if it is this far off
_LENGTH_SIGMA_M = 0.003
_ROUNDS, _STEP = 4, 1e-3
_SPANS = {
    "upper_arm": ("{side}_shoulder", "{side}_elbow"),
    "forearm": ("{side}_elbow", "{side}_wrist"),
    "thigh": ("{side}_hip", "{side}_knee"),
    "shank": ("{side}_knee", "{side}_ankle"),
}


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
        """(N,) the likeliest shape of a body with these lengths (`length_names`); unknown ones are left out."""
        names = [name for name in length_names() if name in lengths_m]
        wanted = np.array([lengths_m[name] for name in names])
        shape = np.zeros(len(self.vertex_shapes))
        for _ in range(_ROUNDS):
            have = self._lengths(names, shape)
            steps = _STEP * np.eye(len(shape))
            slopes = np.array([(self._lengths(names, shape + step) - have) / _STEP for step in steps]).T
            information = slopes.T @ slopes / _LENGTH_SIGMA_M**2 + np.eye(len(shape))
            shape = shape + np.linalg.solve(information, slopes.T @ (wanted - have) / _LENGTH_SIGMA_M**2 - shape)
        return shape

    def _lengths(self, names: list[str], shape: Array) -> Array:
        points = self.points_of(shape)
        return np.array([np.linalg.norm(points[a] - points[b]) for a, b in (length_names()[name] for name in names)])


@cache
def length_names() -> dict[str, tuple[str, str]]:
    """Name of a length -> the keypoints it is between."""
    found = {f"{s}_{name}": (a.format(side=s), b.format(side=s)) for s in ("left", "right") for name, (a, b) in _SPANS.items()}
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
