"""A skeleton in motion inside a page: play, pause, scrub, turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.formats.gltf import Skin, smooth_quaternions

from .packing import packed

Side = Literal["left", "right", "mid"]
_MOST_HZ = 30.0
_MOST_FRAMES = 5400
# a millimetre, which no screen shows
_STEP_M, _STEP_S, _STEP_TURN = (1, 3), (1, 3), (1, 4)
_WEIGHT, _BIND_DECIMALS = 255, 5


@dataclass(frozen=True, eq=False, kw_only=True)
class PlayerMesh:
    """A person as a mesh over time.

    Attributes:
        skin: the mesh and its joints.
        rotation: (T', J, 3, 3) world_from_joint at the time steps that are kept, world Z up. position: (T', J, 3) metres.
    """

    skin: Skin
    rotation: Array
    position: Array


@dataclass(frozen=True, eq=False)
class Player:
    """Stick figures over time, drawn by the page itself.

    Kept are at most 30 time steps per second and the first 5400 of those, positions to 1 mm.

    Attributes:
        t_s: (T,) seconds, growing. xyz_m: (T, N, K, 3) metres, Z up; NaN where missing.
        bones: (B, 2) places of keypoints. sides: of every bone, for its colour. people: a name for each of N.
        right_left: pairs of keypoints by which the page knows where a person faces, e.g. the hips; none: towards +x.
        meshes: of each of N, None where there is none; empty: of no person.
    """

    t_s: Array
    xyz_m: Array
    _: KW_ONLY
    bones: Array
    sides: Sequence[Side]
    people: Sequence[str]
    right_left: Sequence[tuple[int, int]] = ()
    meshes: Sequence[PlayerMesh | None] = ()
    kind: ClassVar[str] = "player"

    def __post_init__(self) -> None:
        shape = np.shape(self.xyz_m)
        if len(shape) != 4 or shape[0] != len(self.t_s) or shape[1] != len(self.people) or shape[3] != 3:
            raise InputError(
                f"player: expected positions ({len(self.t_s)}, {len(self.people)}, K, 3) of as many times and people, got {shape}"
            )
        if len(self.bones) != len(self.sides):
            raise InputError(f"player: expected a side for each of {len(self.bones)} bones, got {len(self.sides)}")

    @property
    def kept(self) -> Array:
        """Places (T',) of the time steps that are stored."""
        return kept_steps(self.t_s)

    @property
    def note(self) -> str:
        """What is left out, in words; empty if nothing is."""
        kept = self.kept
        if not len(kept) or kept[-1] + (kept[1] - kept[0] if len(kept) > 1 else 1) >= len(self.t_s):
            return ""
        return f"The first {self.t_s[kept[-1]] - self.t_s[0]:.0f} s of {self.t_s[-1] - self.t_s[0]:.0f} s."


def kept_steps(t_s: Array) -> Array:
    """Places (T',) of those of the times (T,) that a player keeps."""
    if len(t_s) < 2:
        return np.arange(len(t_s))
    period_s = float(np.median(np.diff(t_s)))
    step = max(1, round(1 / (_MOST_HZ * period_s))) if period_s > 0 else 1
    return np.arange(0, len(t_s), step)[:_MOST_FRAMES]


def player_content(player: Player) -> dict[str, Any]:
    """A player as the page's script reads it: one packed array per person, keypoint and axis."""
    kept = player.kept
    xyz = np.asarray(player.xyz_m[kept], float)
    t_s = np.asarray(player.t_s, float)[kept]
    meshes = [None if mesh is None else _mesh_content(mesh) for mesh in player.meshes]
    return {
        "meshes": meshes,
        "t": packed(t_s - t_s[:1], step=_STEP_S),
        "people": [
            {"name": name, "xyz": [[packed(xyz[:, n, k, i], step=_STEP_M)["d"] for i in range(3)] for k in range(xyz.shape[2])]}
            for n, name in enumerate(player.people)
        ],
        "step": list(_STEP_M),
        "bones": np.asarray(player.bones).tolist(),
        "sides": list(player.sides),
        "across": [list(pair) for pair in player.right_left],
    }


def _mesh_content(mesh: PlayerMesh) -> dict[str, Any]:
    """Vertices, faces, weights of joints, and each joint's place at rest and over time."""
    skin, joints = mesh.skin, range(mesh.rotation.shape[1])
    turns = [smooth_quaternions(mesh.rotation[:, j]) for j in joints]
    return {
        "vertices": packed(skin.vertices.ravel(), step=_STEP_M)["d"],
        "faces": skin.faces.ravel().tolist(),
        "joint": skin.joint.ravel().tolist(),
        "weight": _whole(skin.weight).ravel().tolist(),
        "bind": np.round(skin.joint_from_mesh[:, :3], _BIND_DECIMALS).reshape(len(skin.joint_from_mesh), 12).tolist(),
        "turn": [[packed(turn[:, i], step=_STEP_TURN)["d"] for i in range(4)] for turn in turns],
        "place": [[packed(mesh.position[:, j, i], step=_STEP_M)["d"] for i in range(3)] for j in joints],
        "step": list(_STEP_M),
        "turn_step": list(_STEP_TURN),
    }


def _whole(weight: Array) -> Array:
    """Weights (V, W) in 255 parts; the largest takes what rounding leaves, as a sum that is not 1 moves a vertex by metres."""
    parts = np.round(_WEIGHT * weight).astype(int)
    parts[np.arange(len(parts)), parts.argmax(axis=1)] += _WEIGHT - parts.sum(axis=1)
    return np.asarray(parts)
