"""A body that can be posed: forward kinematics, skin, keypoints, segment frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posefuse.core import SE3
from posefuse.core.arrays import Array

from . import anatomy
from .angles import SEGMENTS, joint_angles_from_rotations
from .colours import GROUPS, colour_groups, completed_shape
from .mesh import rest_mesh
from .settings import BodyShapeSettings


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulatedBody:
    """One body: what the renderer draws and what is true about it. Made by `build_body`.

    Rest pose: standing on the floor at the origin, facing +X, left +Y, up +Z, metres.

    Attributes:
        settings: everything decided, nothing None but `random_seed` and `weight_kg`.
        bone_names: B rig bones. bone_parent: (B,) index, -1 at the root; parents come first.
        bone_centre: (B, 3) rest point each bone turns about.
        vertices_rest: (V, 3) m. faces: (F, 3) int.
        bone_index, bone_weight: (V, W) skin weights over bones; rows sum to 1; unused places have weight 0.
        world_from_bone_rest: (B, 4, 4).
        colour_group: (V,) int into `colour_names`. colours: (G, 3) red, green, blue in [0, 1].
        segment_axes: (S, 3, 3) rest axes of `SEGMENTS` as columns X, Y, Z. segment_origin: (S, 3).
        segment_bone: (S,) the bone each is fixed to.
        points_rest: each `ANATOMICAL23` keypoint (3,) at rest.
    """

    settings: BodyShapeSettings
    bone_names: tuple[str, ...]
    bone_parent: Array
    bone_centre: Array
    vertices_rest: Array
    faces: Array
    bone_index: Array
    bone_weight: Array
    world_from_bone_rest: Array
    colour_group: Array
    colour_names: tuple[str, ...]
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
        """World poses of all bones.

        Args:
            turn_world: bone name -> (T, 3, 3) rotation of that bone from its rest orientation, in world axes. A bone not
                named keeps its place on its parent. The root must be named.
            centre_world: (T, 3) where the root's turning centre (middle of the hip centres) is.

        Returns:
            world_from_bone (T, B, 4, 4).
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
        return moved @ self.world_from_bone_rest

    def moved_from_rest(self, world_from_bone: Array) -> Array:
        """(T, B, 4, 4) rigid motion of each bone from its rest pose: the matrices linear blend skinning uses."""
        return world_from_bone @ np.linalg.inv(self.world_from_bone_rest)

    def vertices(self, world_from_bone: Array) -> Array:
        """(T, V, 3) skin by linear blend skinning: what the renderer draws."""
        moved = self.moved_from_rest(world_from_bone)
        placed = np.einsum("tvwij,vj->tvwi", moved[:, self.bone_index, :3, :3], self.vertices_rest)
        placed += moved[..., :3, 3][:, self.bone_index]
        return np.asarray(np.einsum("tvwi,vw->tvi", placed, self.bone_weight))

    def keypoints(self, world_from_bone: Array) -> Array:
        """(T, 23, 3) `ANATOMICAL23` points in world metres; see `anatomy` for each one's definition."""
        used = np.flatnonzero(self.keypoint_share.any(axis=0))
        moved = self.moved_from_rest(world_from_bone)[:, used]
        rotation, translation = moved[..., :3, :3], moved[..., :3, 3]
        turned = np.einsum("tbij,kbj->tki", rotation, self.keypoint_moment[:, used], optimize=True)
        return np.asarray(turned + np.einsum("kb,tbi->tki", self.keypoint_share[:, used], translation))

    def segments(self, world_from_bone: Array) -> SE3:
        """world_from_segment of `SEGMENTS`, batch (T, S)."""
        moved = self.moved_from_rest(world_from_bone)[:, self.segment_bone]
        origin = (moved[..., :3, :3] @ self.segment_origin[..., None])[..., 0] + moved[..., :3, 3]
        return SE3.from_matrix(moved[..., :3, :3] @ self.segment_axes, origin)

    def angles(self, world_from_bone: Array) -> Array:
        """(T, J, 3) angles in radians of `JOINTS`, named by `ANGLE_NAMES`; see `angles` for sequences and signs."""
        moved = self.moved_from_rest(world_from_bone)[:, self.segment_bone]
        return joint_angles_from_rotations(moved[..., :3, :3] @ self.segment_axes)


def build_body(settings: BodyShapeSettings) -> SimulatedBody:
    """Make a body. Needs the extra ``sim``.

    Raises:
        ConfigError: a stature or weight the body model cannot take. DependencyError: the extra is missing.
    """
    decided = completed_shape(settings)
    mesh = rest_mesh(decided)
    axes, origin = anatomy.rest_segment_frames(mesh)
    share, moment = anatomy.keypoint_moments(mesh)
    group, colours = colour_groups(mesh, decided)
    return SimulatedBody(
        settings=decided,
        bone_names=mesh.bone_names,
        bone_parent=mesh.bone_parent,
        bone_centre=anatomy.turning_centres(mesh),
        vertices_rest=mesh.vertices,
        faces=mesh.faces,
        bone_index=mesh.bone_index,
        bone_weight=mesh.bone_weight,
        world_from_bone_rest=mesh.world_from_bone,
        colour_group=group,
        colour_names=GROUPS,
        colours=colours,
        segment_axes=axes,
        segment_origin=origin,
        segment_bone=np.array([mesh.bone_names.index(anatomy.segment_bone(s)) for s in SEGMENTS]),
        points_rest=anatomy.rest_keypoints(mesh),
        keypoint_share=share,
        keypoint_moment=moment,
    )
