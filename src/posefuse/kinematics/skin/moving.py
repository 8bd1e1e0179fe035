"""A person's mesh while they move: posed by the segment frames of live joint angles, one time step after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.core import SE3, JointAngles, Pose3D, PoseSequence
from posefuse.core.arrays import Array
from posefuse.formats.bvh import BvhData
from posefuse.formats.gltf import Skin
from posefuse.kinematics.animation import FILE_FROM_SEGMENT, FILE_FROM_WORLD, animation_from_joints

from .mesh import skin_of

_SAMPLE_NS = 100_000_000
_FIRST_SAMPLES, _MOST_SAMPLES = 10, 320
_USUAL_SHARE = 0.5


class MovingSkin:
    """One person's mesh over live time steps. No body is fitted: it follows the segment frames that the joint angles have.

    Proportions are medians over what was seen so far, ten times a second: made after one second, and again after 2, 4, 8, 16
    and 32 s. A segment that is not known for a moment keeps its turn in the segment it is attached to.

    Attributes:
        skin: None while too little was seen. revision: one more each time it is made.
    """

    def __init__(self) -> None:
        self.skin: Skin | None = None
        self.revision = 0
        self._rest: BvhData | None = None
        self._samples: list[tuple[Pose3D, JointAngles]] = []
        self._due = _FIRST_SAMPLES
        self._turns: dict[int, Array] = {}

    def step(self, pose: Pose3D, joints: JointAngles) -> Array | None:
        """(J, 3, 4) world_from_mesh of each joint of `skin`, whose weights blend them; None where the pelvis is not known.

        Args:
            pose: of one person (N = 1). joints: its angles (T = 1, N = 1).
        """
        if not np.isfinite(joints.world_from_segment.xyz[0, 0, joints.segments.index("pelvis")]).all():
            return None
        self._learn(pose, joints)
        if self.skin is None or self._rest is None:
            return None
        rotation, position = self._posed(self._rest, joints)
        linear = rotation @ self.skin.joint_from_mesh[:, :3, :3]
        shift = (rotation @ self.skin.joint_from_mesh[:, :3, 3:])[..., 0] + position
        return np.asarray(FILE_FROM_WORLD.T @ np.concatenate([linear, shift[..., None]], axis=-1))

    def _learn(self, pose: Pose3D, joints: JointAngles) -> None:
        if self._due > _MOST_SAMPLES or (self._samples and pose.t_ns - self._samples[-1][0].t_ns < _SAMPLE_NS):
            return
        self._samples.append((pose, joints))
        if len(self._samples) < self._due:
            return
        self._due *= 2
        self._rest = _rest_of(self._samples)
        self.skin = skin_of(self._rest)
        self.revision += 1
        self._turns.clear()
        if self._due > _MOST_SAMPLES:
            self._samples.clear()

    def _posed(self, rest: BvhData, joints: JointAngles) -> tuple[Array, Array]:
        """Rotations (J, 3, 3) and positions (J, 3) in the axes of the file."""
        frames = joints.world_from_segment.matrix()[0, 0]
        place = {name: s for s, name in enumerate(joints.segments)}
        rotation, position = np.empty((len(rest.names), 3, 3)), np.empty((len(rest.names), 3))
        position[0] = FILE_FROM_WORLD @ joints.world_from_segment.xyz[0, 0, place["pelvis"]]
        for j, (name, p) in enumerate(zip(rest.names, rest.parent.tolist(), strict=True)):
            over = rotation[p] if p >= 0 else np.eye(3)
            frame = frames[place[name]] if name in place else np.full((3, 3), np.nan)
            if np.isfinite(frame).all():
                rotation[j] = FILE_FROM_WORLD @ frame @ FILE_FROM_SEGMENT.T
                self._turns[j] = over.T @ rotation[j]
            else:
                rotation[j] = over @ self._turns.get(j, np.eye(3))
            if p >= 0:
                position[j] = position[p] + over @ rest.offset[j]
        return rotation, position


def _rest_of(samples: list[tuple[Pose3D, JointAngles]]) -> BvhData:
    """The skeleton of a person's median lengths; of the segments that are usually known, from the samples that have them all."""
    xyz = np.stack([joints.world_from_segment.xyz[0] for _, joints in samples])
    wxyz = np.stack([joints.world_from_segment.wxyz[0] for _, joints in samples])
    known = np.isfinite(xyz).all(axis=-1)[:, 0]
    usual = known.mean(axis=0) >= _USUAL_SHARE
    chosen = np.flatnonzero(known[:, usual].all(axis=1))
    if len(chosen) < 2:
        # never all at once: what every sample has, the pelvis at least
        usual, chosen = known.all(axis=0), np.arange(len(samples))
    # times are only an order here: the samples that were chosen have no gaps
    t_ns = np.arange(len(chosen)) * _SAMPLE_NS
    poses = PoseSequence.from_poses(
        [replace(samples[i][0], t_ns=int(t), person_id=np.zeros(1, np.int64)) for i, t in zip(chosen, t_ns, strict=True)]
    )
    unusual = ~usual[None, None, :, None]
    frames = SE3(np.where(unusual, np.nan, wxyz[chosen]), np.where(unusual, np.nan, xyz[chosen]))
    angle, sigma = (np.concatenate([getattr(samples[i][1], name) for i in chosen]) for name in ("angle_rad", "sigma_rad"))
    joints = replace(
        samples[0][1], t_ns=t_ns, person_id=poses.person_id, world_from_segment=frames, angle_rad=angle, sigma_rad=sigma
    )
    return animation_from_joints(poses, joints)
