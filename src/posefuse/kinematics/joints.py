"""3D poses to segment frames and joint angles, recorded and live."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from posefuse.core import SE3, JointAngles, Pose3D, PoseSequence, ShapeError, Skeleton
from posefuse.core.arrays import Array, give_away
from posefuse.core.se3 import wxyz_from_matrix

from . import kernels
from .definitions import (
    ANGLE_NAMES,
    JOINT_NAMES,
    JOINTS,
    LIMBS,
    MIDPOINTS,
    POINTS,
    SEGMENT_NAMES,
    SEGMENTS,
    SEQUENCES,
    landmark_pairs,
)  # fmt: skip
from .settings import JointSettings
from .side_clues import check_sides

_HINGE_MEMORY_S = 0.2
# nearer than this to gimbal lock the first and last angle of a sequence are NaN, and so is an angle less certain than this
_LOCK_RAD, _SIGMA_LIMIT_RAD = 0.12, 0.6
# standard deviation taken for points that come without a covariance
_UNKNOWN_SIGMA_M = 0.01
_ISB_FROM_WORLD = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])  # X forward, Y up, Z right in world axes
_PLACES = {"ground": -1, **{name: place for place, name in enumerate(SEGMENT_NAMES)}}


def _pair(name: str) -> list[int]:
    """Landmarks whose mean is a point, twice the same for one."""
    return [POINTS.index(end) for end in MIDPOINTS.get(name, (name, name))]


_TABLE = kernels.BodyTable(
    pairs=np.array([[_pair(name) for name in (s.origin, *s.first[:2], *s.second[:2])] for s in SEGMENTS]),
    axes=np.array([[s.first[2], s.second[2], s.limb, s.name.endswith(("forearm", "shank"))] for s in SEGMENTS]),
    raised=np.array([s.raised_rad for s in SEGMENTS]),
    limb_points=np.array([[POINTS.index(name) for name in (limb.proximal, limb.middle, limb.distal)] for limb in LIMBS]),
    limb_parents=np.array([_PLACES[limb.parent] for limb in LIMBS]),
    bends=np.array([limb.bend for limb in LIMBS]),
    joint_segments=np.array([[_PLACES[joint.parent], _PLACES[joint.child]] for joint in JOINTS]),
    sequence=np.array([SEQUENCES.index(joint.sequence) for joint in JOINTS]),
    mirrored=np.array([joint.mirrored for joint in JOINTS]),
    sign=np.array([joint.sign for joint in JOINTS], np.float64),
    determined=np.array([joint.determined for joint in JOINTS]),
    ground=_ISB_FROM_WORLD,
)


def joints_from_poses(sequence: PoseSequence, settings: JointSettings | None = None) -> JointAngles:
    """Segment frames and joint angles of a recording, the planes of straight limbs carried from both sides in time.

    Angles are continuous over time (unwrapped; those of joints within 225 degrees), radians, flexion positive on both sides;
    `sigma_rad` is propagated from `cov_world`, whose keypoints are taken as independent of each other. What is not defined is
    NaN.

    Raises:
        InputError: left and right of a person are plainly swapped (see `check_sides`).
    """
    settings = settings or JointSettings()
    check_sides(sequence)
    work = FrameBuffers(sequence.skeleton, settings)
    shape = sequence.xyz_world.shape[:2]
    wxyz, origin = np.empty((*shape, len(SEGMENT_NAMES), 4)), np.empty((*shape, len(SEGMENT_NAMES), 3))
    angles, sigmas = np.empty((*shape, len(JOINT_NAMES), 3)), np.empty((*shape, len(JOINT_NAMES), 3))
    for n in range(shape[1]):
        planes = _smoothed_planes(sequence, n, work)
        last = np.full((len(JOINT_NAMES), 3), np.nan)
        for i in range(shape[0]):
            work.read(sequence.xyz_world[i, n], sequence.cov_world[i, n])
            work.solve(planes[i])
            work.unwrap(last)
            wxyz[i, n], origin[i, n] = frames_of(work.rotation, work.origins())
            angles[i, n], sigmas[i, n] = work.angles, work.sigmas
    return joints_value(sequence.t_ns, sequence.person_id, wxyz, origin, angles, sigmas)


class JointTracker:
    """Frames and angles of live poses. Remembers, per person, the limb planes and the turn each angle is on."""

    def __init__(self, skeleton: Skeleton, settings: JointSettings | None = None) -> None:
        self.skeleton = skeleton
        self._work = FrameBuffers(skeleton, settings)
        self._memories: dict[int, _Memory] = {}

    def step(self, pose: Pose3D) -> JointAngles:
        """Joints of one time step (T = 1). People that are gone are forgotten.

        Raises:
            ShapeError: another skeleton than the tracker was made for.
        """
        if pose.skeleton != self.skeleton:
            raise ShapeError(f"JointTracker.step: expected skeleton {self.skeleton.name}, got {pose.skeleton.name}")
        count, work = len(pose.person_id), self._work
        rotation = np.empty((1, count, len(SEGMENT_NAMES), 3, 3))
        origin = np.empty((1, count, len(SEGMENT_NAMES), 3))
        angles, sigmas = np.empty((2, 1, count, len(JOINT_NAMES), 3))
        memories = {}
        for n, person in enumerate(pose.person_id.tolist()):
            memory = self._memories.get(person) or _Memory(pose.t_ns)
            work.read(pose.xyz_world[n], pose.cov_world[n])
            work.step_planes(memory.planes, (pose.t_ns - memory.t_ns) * 1e-9)
            work.solve(work.updated)
            work.unwrap(memory.angles)
            rotation[0, n], origin[0, n] = work.rotation, work.origins()
            angles[0, n], sigmas[0, n] = work.angles, work.sigmas
            memory.t_ns = pose.t_ns
            memories[person] = memory
        self._memories = memories
        return joints_value(np.array([pose.t_ns]), pose.person_id, *frames_of(rotation, origin), angles, sigmas)


def frames_of(rotation: Array, origin: Array) -> tuple[Array, Array]:
    """Quaternions (..., 4) and origins of frames (..., 3, 3), (..., 3); a frame that is NaN has no origin either."""
    return wxyz_from_matrix(rotation), np.where(np.isnan(rotation[..., :1, 0]), np.nan, origin)


def joints_value(t_ns: Array, person_id: Array, wxyz: Array, origin: Array, angles: Array, sigmas: Array) -> JointAngles:
    """Joints of arrays over (T, N), which it takes over."""
    give_away(wxyz, origin, angles, sigmas)
    frames = SE3(wxyz, origin)
    return JointAngles(
        t_ns=t_ns,
        person_id=person_id,
        segments=SEGMENT_NAMES,
        world_from_segment=frames,
        joints=JOINT_NAMES,
        angle_names=ANGLE_NAMES,
        angle_rad=angles,
        sigma_rad=sigmas,
    )


@dataclass
class _Memory:
    t_ns: int
    planes: Array = field(default_factory=lambda: np.full((len(LIMBS), kernels.MEMORY_SIZE), np.nan))
    angles: Array = field(default_factory=lambda: np.full((len(JOINTS), 3), np.nan))


class FrameBuffers:
    """The arrays one person's frame passes through; overwritten by each call, so that nothing is allocated live."""

    def __init__(self, skeleton: Skeleton, settings: JointSettings | None = None) -> None:
        self.settings = settings or JointSettings()
        self.pairs = landmark_pairs(skeleton)
        s, q, p = len(SEGMENT_NAMES), len(JOINT_NAMES), len(POINTS)
        self.points, self.points_cov = np.empty((p, 3)), np.empty((p, 3, 3))
        self.expected, self.updated = np.empty((2, len(LIMBS), kernels.PLANE_SIZE))
        self.limits = np.array([np.sin(_LOCK_RAD), _SIGMA_LIMIT_RAD])
        self.rotation, by_first, by_second = np.empty((3, s, 3, 3))
        self._frames = kernels.FrameArrays(self.rotation, by_first, by_second, np.empty(s))
        self.angles, self.sigmas = np.empty((2, q, 3))
        self.weights = np.empty((q, p, 3, 3))
        self._angles = kernels.Angles(self.angles, self.sigmas, self.weights)

    def read(self, xyz_world: Array, cov_world: Array) -> None:
        """Take in keypoints (K, 3) and covariances (K, 3, 3)."""
        kernels.gather_landmarks(xyz_world, cov_world, self.pairs, _UNKNOWN_SIGMA_M**2, self.points, self.points_cov)

    def step_planes(self, memory: Array, elapsed_s: float) -> None:
        """Move the limb planes (`memory`) to the points taken in; leaves `expected` and `updated`."""
        grown = self.settings.turn_rate_rad_sqrt_s**2 * abs(elapsed_s)
        # a hinge that is not ideal errs the same way frame after frame: it must not average out
        repeats = max(1.0, _HINGE_MEMORY_S / max(abs(elapsed_s), 1e-3))
        kernels.step_planes(
            self.points, self.points_cov, _TABLE, memory, grown, self.settings.hinge_play_rad**2, repeats, self.expected,
            self.updated,
        )  # fmt: skip

    def solve(self, planes: Array) -> None:
        """Frames and angles of the points taken in, limbs turned by `planes` (L, PLANE_SIZE)."""
        kernels.solve_joints(self.points, self.points_cov, planes, _TABLE, self.limits, self._frames, self._angles)

    def unwrap(self, last: Array) -> None:
        """Move the angles by whole turns to the nearest of their last values (J, 3), which are then replaced."""
        kernels.unwrap(self.angles, last, _TABLE)

    def drop_uncertain(self) -> None:
        """Angles whose standard deviation has grown past the limit become NaN."""
        lost = ~(self.sigmas <= _SIGMA_LIMIT_RAD)
        self.angles[lost] = np.nan
        self.sigmas[lost] = np.nan

    def frames_alone(self, xyz_world: Array) -> Array:
        """(S, 3, 3) frames of one time step without any memory; limbs whose plane is not clear are NaN."""
        self.read(xyz_world, np.full((len(xyz_world), 3, 3), np.nan))
        self.step_planes(_Memory(0).planes, 0.0)
        self.solve(self.updated)
        return np.array(self.rotation)

    def origins(self) -> Array:
        """(S, 3) origins of the frames."""
        one, other = _TABLE.pairs[:, 0].T
        return np.asarray(0.5 * (self.points[one] + self.points[other]))


def _smoothed_planes(sequence: PoseSequence, person: int, work: FrameBuffers) -> Array:
    """(T, L, PLANE_SIZE) limb planes from the past, the present and the future together."""
    t_s = sequence.t_ns * 1e-9
    past, future = np.empty((2, len(t_s), len(LIMBS), kernels.PLANE_SIZE))
    for planes, order in ((past, range(len(t_s))), (future, range(len(t_s) - 1, -1, -1))):
        memory = _Memory(0).planes
        before = t_s[order[0]] if len(order) else 0.0
        for i in order:
            work.read(sequence.xyz_world[i, person], sequence.cov_world[i, person])
            work.step_planes(memory, t_s[i] - before)
            before = t_s[i]
            # the present counts once
            planes[i] = work.updated if planes is past else work.expected
    return _merged_planes(past, future)


def _merged_planes(past: Array, future: Array) -> Array:
    """Planes (..., PLANE_SIZE) weighted by their inverse variances; a missing one counts nothing.

    A normal guessed from the parent alone is no evidence: it counts only where neither side has any.
    """
    weights = []
    for planes in (past, future):
        var = planes[..., 3]
        known = np.isfinite(var) & (var < kernels.UNKNOWN_VAR)
        weights.append(np.where(known, 1.0 / np.maximum(np.where(known, var, 1.0), 1e-12), 0.0))
    total = weights[0] + weights[1]
    merged = past.copy()
    seen = total > 0
    summed = np.nan_to_num(past[..., :3]) * weights[0][..., None] + np.nan_to_num(future[..., :3]) * weights[1][..., None]
    normal = summed[seen]
    merged[seen, :3] = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    merged[seen, 3] = 1.0 / total[seen]
    alone = ~seen & np.isnan(past[..., 3])
    merged[alone, :4] = future[alone, :4]
    return merged
