"""A body that can be posed: what is left open about it decided, forward kinematics, skin, keypoints, segment frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from posefuse.core import SE3
from posefuse.core.arrays import Array

from . import anatomy
from .anatomy import SEGMENTS, joint_angles_from_rotations
from .mesh import BodyShapeSettings, RestMesh, masculine, rest_mesh

GROUPS = ("shirt", "trousers", "shoes", "skin", "hair")
_DEFAULT = {"shirt": "#b22626", "trousers": "#1a2659", "shoes": "#0d0d0d", "skin": "#d9a68c", "hair": "#26190d"}
_AVERAGE: dict[str, Any] = {"sex": "male", "age_years": 30.0, "muscle": 0.5} | _DEFAULT
_PALETTE = {
    "shirt": ("#b22626", "#2a6f4e", "#e0dfd5", "#30475e", "#c98a1b", "#6a4c93", "#3a86c8", "#222222"),
    "trousers": ("#1a2659", "#2b2b2b", "#5b4636", "#6b705c", "#3d405b", "#8d99ae"),
    "shoes": ("#0d0d0d", "#e8e8e8", "#5e3023", "#22333b"),
    "skin": ("#f0c8a8", "#d9a68c", "#c68e6a", "#a56b46", "#7b4a2d", "#4f2f1e"),
    "hair": ("#26190d", "#0f0c0a", "#6b4423", "#a67c45", "#8a8a8a", "#5a1f10"),
}
_STATURE_M = {"female": (1.63, 0.065), "male": (1.77, 0.072)}
_LEGS = ("upperleg", "lowerleg", "pelvis", "root")
_FEET = ("foot", "toe")
_TORSO = ("spine", "clavicle", "shoulder", "upperarm")


def completed_shape(settings: BodyShapeSettings) -> BodyShapeSettings:
    """The same settings with nothing left open; the same seed always decides the same."""
    drawn, sigmas = (_AVERAGE, 0.0) if settings.random_seed is None else _drawn(settings.random_seed)
    decided = drawn | {name: value for name, value in vars(settings).items() if value is not None}
    height_m = settings.height_m or _stature(decided["sex"], decided["age_years"], sigmas)
    return replace(settings, **decided | {"height_m": height_m})


def _drawn(seed: int) -> tuple[dict[str, Any], float]:
    """What is drawn of a body, and by how many standard deviations it is taller than the average."""
    rng = np.random.default_rng(seed)
    shape = {
        "sex": ("female", "male")[rng.integers(2)],
        "age_years": float(rng.uniform(20, 70)),
        "muscle": float(rng.uniform(0.3, 0.8)),
    }
    sigmas = float(np.clip(rng.standard_normal(), -2, 2))
    return shape | {group: colours[rng.integers(len(colours))] for group, colours in _PALETTE.items()}, sigmas


def _stature(sex: str | float, age_years: float, sigmas: float) -> float:
    mean, sd = (np.interp(masculine(sex), (0, 1), ends) for ends in zip(*_STATURE_M.values(), strict=True))
    grown = np.interp(age_years, (5, 18), (0.63, 1.0))
    return float((mean + sigmas * sd) * grown)


def colour_groups(mesh: RestMesh, settings: BodyShapeSettings) -> tuple[Array, Array]:
    """The group (V,) in `GROUPS` each vertex wears, and the colour (G, 3) of each group in [0, 1].

    A vertex wears what its strongest bone wears; the top and back of the head is hair.
    """
    strongest = mesh.bone_index[np.arange(len(mesh.vertices_rest)), mesh.bone_weight.argmax(axis=1)]
    names = np.array(mesh.bone_names)[strongest]
    group = np.full(len(names), GROUPS.index("skin"))
    for wearers, wears in ((_TORSO, "shirt"), (_LEGS, "trousers"), (_FEET, "shoes")):
        group[np.char.startswith(names[:, None], np.array(wearers)).any(axis=1)] = GROUPS.index(wears)
    # the lowest spine bone moves the crotch as well
    below_waist = mesh.vertices_rest[:, 2] < mesh.bone_head_rest[mesh.bone_names.index("spine04"), 2]
    group[below_waist & np.char.startswith(names, "spine")] = GROUPS.index("trousers")
    head = names == "head"
    centre = mesh.vertices_rest[head].mean(axis=0)
    size = np.ptp(mesh.vertices_rest[head][:, 2]) / 0.26
    x, z = mesh.vertices_rest[:, 0] - centre[0], mesh.vertices_rest[:, 2] - centre[2]
    hair = head & ((z > 0.05 * size) | ((x < -0.02 * size) & (z > -0.04 * size)))
    group[hair] = GROUPS.index("hair")
    rgb = [[int(getattr(settings, g)[i : i + 2], 16) / 255 for i in (1, 3, 5)] for g in GROUPS]
    return group, np.array(rgb)


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatedBody(RestMesh):
    """One body: what the renderer draws and what is true about it. Made by `build_body`.

    Attributes:
        settings: everything decided, nothing None but `random_seed`.
        bone_centre: (B, 3) rest point each bone turns about.
        colour_group: (V,) int into `GROUPS`. colours: (G, 3) red, green, blue in [0, 1].
        segment_axes: (S, 3, 3) rest axes of `SEGMENTS` as columns X, Y, Z. segment_origin: (S, 3).
        segment_bone: (S,) the bone each is fixed to.
        points_rest: each `ANATOMICAL23` keypoint (3,) at rest.
    """

    settings: BodyShapeSettings
    bone_centre: Array
    colour_group: Array
    colours: Array
    segment_axes: Array
    segment_origin: Array
    segment_bone: Array
    points_rest: Mapping[str, Array]
    keypoint_share: Array
    keypoint_moment: Array

    def bone(self, name: str) -> int:
        """Place of a bone on axis B."""
        return self.bone_names.index(name)

    def rest_rotation(self, proximal: str, distal: str) -> Array:
        """(3, 3) proximal_from_distal of two segments at rest."""
        return np.asarray(self.segment_axes[SEGMENTS.index(proximal)].T @ self.segment_axes[SEGMENTS.index(distal)])

    def pose(self, turn_world: Mapping[str, Array], centre_world: Array) -> Array:
        """The rigid motion of each bone from rest: the matrices that linear blend skinning uses.

        Args:
            turn_world: bone name -> (T, 3, 3) rotation of that bone from its rest orientation, in world axes. A bone not
                named keeps its place on its parent. The root must be named.
            centre_world: (T, 3) where the root's turning centre (middle of the hip centres) is.

        Returns:
            (T, B, 4, 4) in world axes.
        """
        moved = np.zeros((len(centre_world), len(self.bone_names), 4, 4))
        moved[..., 3, 3] = 1.0
        for b, (name, parent) in enumerate(zip(self.bone_names, self.bone_parent, strict=True)):
            if name not in turn_world:
                moved[:, b] = moved[:, parent]
                continue
            rotation, centre = turn_world[name], self.bone_centre[b]
            here = centre_world if parent < 0 else moved[:, parent, :3, :3] @ centre + moved[:, parent, :3, 3]
            moved[:, b, :3, :3] = rotation
            moved[:, b, :3, 3] = here - rotation @ centre
        return moved

    def vertices(self, moved: Array) -> Array:
        """(T, V, 3) skin by linear blend skinning: what the renderer draws."""
        placed = np.einsum("tvwij,vj->tvwi", moved[:, self.bone_index, :3, :3], self.vertices_rest)
        placed += moved[..., :3, 3][:, self.bone_index]
        return np.asarray(np.einsum("tvwi,vw->tvi", placed, self.bone_weight))

    def keypoints(self, moved: Array) -> Array:
        """(T, 23, 3) `ANATOMICAL23` points in world metres; see `anatomy` for each one's definition."""
        used = np.flatnonzero(self.keypoint_share.any(axis=0))
        rotation, translation = moved[:, used, :3, :3], moved[..., :3, 3][:, used]
        turned = np.einsum("tbij,kbj->tki", rotation, self.keypoint_moment[:, used], optimize=True)
        return np.asarray(turned + np.einsum("kb,tbi->tki", self.keypoint_share[:, used], translation))

    def segments(self, moved: Array) -> SE3:
        """world_from_segment of `SEGMENTS`, batch (T, S)."""
        turned = moved[:, self.segment_bone, :3, :3]
        origin = (turned @ self.segment_origin[..., None])[..., 0] + moved[..., :3, 3][:, self.segment_bone]
        return SE3.from_matrix(turned @ self.segment_axes, origin)

    def angles(self, moved: Array) -> Array:
        """(T, J, 3) angles in radians of `JOINTS`, named by `ANGLE_NAMES`; see `angles` for sequences and signs."""
        return joint_angles_from_rotations(moved[:, self.segment_bone, :3, :3] @ self.segment_axes)


def build_body(settings: BodyShapeSettings) -> SimulatedBody:
    """Make a body; raises ConfigError for a stature that the body model cannot take."""
    decided = completed_shape(settings)
    mesh = rest_mesh(decided)
    axes, origin = anatomy.rest_segment_frames(mesh)
    share, moment = anatomy.keypoint_moments(mesh)
    group, colours = colour_groups(mesh, decided)
    return SimulatedBody(
        **vars(mesh),
        settings=decided,
        bone_centre=anatomy.turning_centres(mesh),
        colour_group=group,
        colours=colours,
        segment_axes=axes,
        segment_origin=origin,
        segment_bone=np.array([mesh.bone_names.index(anatomy.segment_bone(s)) for s in SEGMENTS]),
        points_rest=anatomy.rest_keypoints(mesh),
        keypoint_share=share,
        keypoint_moment=moment,
    )
