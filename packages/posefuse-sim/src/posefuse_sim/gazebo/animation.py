"""People as COLLADA actors: the skin, and the motion baked into keys.

Between keys Gazebo turns each joint along the shortest turn and moves it on a straight line, in its parent. So keys are set
so densely that this stays within a set distance of the true motion (`baked`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from posefuse.core import ConfigError
from posefuse.core.arrays import Array
from posefuse.formats.gltf import vertex_normals
from posefuse_sim.body import SimulatedBody
from posefuse_sim.body.body import GROUPS
from posefuse_sim.build import MovingPerson
from posefuse_sim.motion.posture import slerp

from .collada import MOST_WEIGHTS, ColladaSkeleton, Mesh, in_parent, joint_name

# bones that stay this close to their parent's motion are one with it
_RIGID_M = 1e-7
_HALVINGS = 7
# how far the animation may be from the true motion between its keys
MOST_BETWEEN_KEYS_M = 0.0005
# Gazebo cuts the length of an animation down to milliseconds; so much more keeps the last one
_OVER_S = 1e-5
# a body's skin is nowhere further from its joints; a triangle that covers no pixel
_AROUND_M, _SPECK_M = 0.5, 1e-5


def baked(poses_at: Callable[[Array], Array], parent: Array, duration_s: float, rate_hz: float) -> tuple[Array, Array]:
    """Keys of a motion: times (T,) and joint poses (T, J, 4, 4) in the world.

    One key per frame, and more where a joint would be off by more than `MOST_BETWEEN_KEYS_M` in the middle between two.
    Steps of a foot touching the ground take several keys, where a limb swings evenly one per frame is enough.

    Args:
        poses_at: times (T,) -> world_from_joint (T, J, 4, 4). parent: (J,), -1 at the root.

    Raises:
        ConfigError: halving the time between keys again and again does not help.
    """
    t_s = np.append(np.arange(0, duration_s - _OVER_S, 1 / rate_hz), duration_s)
    for _ in range(_HALVINGS + 1):
        world = poses_at(t_s)
        between_s = (t_s[1:] + t_s[:-1]) / 2
        apart_m = np.linalg.norm((halfway(world, parent) - poses_at(between_s))[..., :3, 3], axis=-1).max(axis=-1)
        if apart_m.max() <= MOST_BETWEEN_KEYS_M:
            t_s[-1] += _OVER_S
            return t_s, world
        t_s = np.sort(np.concatenate([t_s, between_s[apart_m > MOST_BETWEEN_KEYS_M]]))
    raise ConfigError(
        f"gazebo: with {rate_hz * 2**_HALVINGS:g} keys per second a joint is still {1000 * apart_m.max():.2f} mm off between "
        f"them, expected at most {1000 * MOST_BETWEEN_KEYS_M:g} mm; the motion jumps at {between_s[apart_m.argmax()]:.2f} s"
    )


def halfway(world_from_joint: Array, parent: Array) -> Array:
    """(T - 1, J, 4, 4) poses in the middle between keys (T, J, 4, 4), as Gazebo has them: half of each move in the parent."""
    local = in_parent(world_from_joint, parent)
    before, after = local[:-1], local[1:]
    middle = (before + after) / 2
    middle[..., :3, :3] = slerp(before[..., :3, :3], after[..., :3, :3], 0.5)
    world = np.empty_like(middle)
    for j, over in enumerate(parent):
        world[:, j] = middle[:, j] if over < 0 else world[:, over] @ middle[:, j]
    return world


def person_actor(person: MovingPerson, duration_s: float, rate_hz: float) -> tuple[Mesh, ColladaSkeleton]:
    """A person's skin and motion. Bones that never move in their parent become one with it: fewer joints, the same skin.

    Raises:
        ConfigError: see `baked`.
    """
    body = person.body
    moved = person.at(np.linspace(0, duration_s, max(2, int(duration_s * rate_hz)))).moved
    joint_of_bone, kept = _merged(moved, body.bone_parent)
    parent = np.array([-1 if body.bone_parent[b] < 0 else joint_of_bone[body.bone_parent[b]] for b in kept])
    rest = np.tile(np.eye(4), (len(kept), 1, 1))
    rest[:, :3, 3] = body.bone_head_rest[kept]
    t_s, world_from_joint = baked(lambda t_s: person.at(t_s).moved[:, kept] @ rest, parent, duration_s, rate_hz)
    index, weight = _four_weights(joint_of_bone, len(kept), body)
    skeleton = ColladaSkeleton(
        names=tuple(joint_name(body.bone_names[b]) for b in kept),
        parent=parent,
        world_from_joint_rest=rest,
        index=index,
        weight=weight,
        t_s=t_s,
        parent_from_joint=in_parent(world_from_joint, parent),
    )
    return _reaching(_body_mesh(body), skeleton, world_from_joint)


def _reaching(mesh: Mesh, skeleton: ColladaSkeleton, world_from_joint: Array) -> tuple[Mesh, ColladaSkeleton]:
    """The same with a speck of a triangle in every corner of the room that the motion takes up.

    A renderer leaves out what is not in the image by the box around the mesh at rest; now that box holds the whole motion.
    """
    places = world_from_joint[..., :3, 3].reshape(-1, 3)
    low, high = places.min(axis=0) - _AROUND_M, places.max(axis=0) + _AROUND_M
    corners = np.array([np.where(np.array(which) > 0, high, low) for which in np.ndindex(2, 2, 2)])
    specks = (corners[:, None] + _SPECK_M * np.eye(3)).reshape(-1, 3)
    name, (colour, faces) = next(iter(mesh.parts.items()))
    first = len(mesh.vertices)
    more = first + np.arange(len(specks)).reshape(-1, 3)
    held = np.zeros((len(specks), MOST_WEIGHTS))
    held[:, 0] = 1.0
    larger = Mesh(
        vertices=np.concatenate([mesh.vertices, specks]),
        normals=np.concatenate([mesh.normals, np.tile(np.ones(3) / np.sqrt(3), (len(specks), 1))]),
        parts={**mesh.parts, name: (colour, np.concatenate([faces, more]))},
    )
    index = np.concatenate([skeleton.index, np.zeros(held.shape, np.int64)])
    return larger, replace(skeleton, index=index, weight=np.concatenate([skeleton.weight, held]))


def _merged(moved: Array, bone_parent: Array) -> tuple[Array, Array]:
    """The joint (B,) each bone becomes, and the bones (J,) that are kept, from motions (T, B, 4, 4) from rest."""
    joint_of_bone = np.zeros(len(bone_parent), np.int64)
    kept: list[int] = []
    for b, parent in enumerate(bone_parent):
        if parent >= 0 and np.abs(moved[:, b] - moved[:, parent]).max() < _RIGID_M:
            joint_of_bone[b] = joint_of_bone[parent]
        else:
            joint_of_bone[b] = len(kept)
            kept.append(b)
    return joint_of_bone, np.array(kept)


def _four_weights(joint_of_bone: Array, joints: int, body: SimulatedBody) -> tuple[Array, Array]:
    """The four joints (V, 4) that hold each vertex most, and their shares (V, 4)."""
    total = np.zeros((len(body.vertices_rest), max(joints, MOST_WEIGHTS)))
    np.add.at(total, (np.arange(len(total))[:, None], joint_of_bone[body.bone_index]), body.bone_weight)
    index = np.argsort(-total, axis=1, kind="stable")[:, :MOST_WEIGHTS]
    weight = np.take_along_axis(total, index, axis=1)
    return np.where(weight > 0, index, 0), weight / weight.sum(axis=1, keepdims=True)


def _body_mesh(body: SimulatedBody) -> Mesh:
    group = body.colour_group[body.faces[:, 0]]
    parts = {name: (body.colours[i], body.faces[group == i]) for i, name in enumerate(GROUPS)}
    worn = {name: part for name, part in parts.items() if len(part[1])}
    return Mesh(vertices=body.vertices_rest, normals=vertex_normals(body.vertices_rest, body.faces), parts=worn)
