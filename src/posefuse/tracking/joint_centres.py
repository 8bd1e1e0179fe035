"""From what a detector marks to anatomical joint centres.

A landmark network is consistent, but what it calls a hip is not the centre of the hip joint. The difference is close to
constant in the body's own directions: each joint is moved by fixed lengths along directions built from the fused keypoints
themselves (trunk, limb above, limb below), and by a little more or less as the person's segments are longer or shorter than
usual. The table is fitted elsewhere; see `bench/fit_joint_centres.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeVar

import numpy as np

from posefuse.core import JointCentres, Kind, Pose3D, PoseSequence, Rig, Skeleton, ViewSequence
from posefuse.core.arrays import Array
from posefuse.core.joint_centres import JOINT_DIRECTIONS, SEGMENT_ENDS
from posefuse.core.skeleton import SIDES
from posefuse.core.view_sequences import PartsOfViews

from .body_directions import body_directions, keypoint_of, lengths_at, segment_lengths
from .sides import parts_of_steps, sides_that_differ, with_sides_swapped

Poses = TypeVar("Poses", Pose3D, PoseSequence)
JOINTS = tuple(JOINT_DIRECTIONS)
# where each joint's directions begin, and the end
_FIRST_DIRECTION = np.cumsum([0, *(len(names) for names in JOINT_DIRECTIONS.values())])
_PART_POSES = 1000
# each round of the inverse leaves two fifths of the error or less: micrometres after these
_INVERSE_ROUNDS = 12
# people further from the average than those of the fit count as no further than this
MOST_LONGER_M = 0.06
_S = len(SEGMENT_ENDS)
# a new person counts as usual, as surely as if that had been seen for so long; chosen on scenes of `bench/fit_lasting_errors.py`
USUAL_S = 0.3
# older measurements fade, in case of an undetected change of person
_MEMORY_S = 60.0
# poses this close in time add no information
_EVERY_NS = 50_000_000
# one pose stands for no longer than this, should the ones before it be missing
_LONGEST_NS = 100_000_000
# only ends known as well as this teach lengths, standard deviation
_SURE_M = 0.05


def to_joint_centres(sequence: PoseSequence, table: JointCentres) -> PoseSequence:
    """A finished recording with its joints at their centres; the segment lengths are learned from all time steps."""
    return at_joint_centres(sequence, table, _lengths(sequence.xyz_world, sequence.skeleton, table))


def at_joint_centres(poses: Poses, table: JointCentres, lengths: Array) -> Poses:
    """The poses with shoulders, elbows, wrists, hips, knees and ankles moved to their centres, ears and nose to their places.

    A joint stays where it is at time steps at which a direction it needs is unknown (a keypoint is missing, or two coincide).
    Covariances stay: the offsets count as constants.

    Args:
        lengths: (N, S) metres of each person's `SEGMENT_ENDS` between joint centres, or (S,) of everybody's; NaN where not known,
            which counts as usual (`JointCentres.usual`).
    """
    return replace(poses, xyz_world=poses.xyz_world + _moves(poses.xyz_world, poses.skeleton, table, lengths))


class LandmarksInParts:
    """What the detector marks, given joint centres (T, N, K, 3): the inverse of `to_joint_centres`, in parts of the time steps.

    Only the segment lengths that each round finds in all time steps are kept: of an hour, landmarks take much memory.
    """

    def __init__(self, centres: Array, skeleton: Skeleton, table: JointCentres) -> None:
        self._centres, self._skeleton, self._table = centres, skeleton, table
        self._lengths: list[Array] = []
        landmarks = centres
        for _ in range(_INVERSE_ROUNDS):
            self._lengths.append(_lengths(landmarks, skeleton, table))
            landmarks = centres - _moves(landmarks, skeleton, table, self._lengths[-1])

    def part(self, steps: slice) -> Array:
        """(T, N, K, 3) those of these time steps."""
        centres = landmarks = self._centres[steps]
        for lengths in self._lengths:
            landmarks = centres - _moves(landmarks, self._skeleton, self._table, lengths)
        return landmarks


def _lengths(landmarks: Array, skeleton: Skeleton, table: JointCentres) -> Array:
    """(N, S) of landmarks (T, N, K, 3), between the joint centres of usual people: what the slopes are fitted to."""
    return segment_lengths(landmarks + _moves(landmarks, skeleton, table, table.usual), skeleton)


def _moves(xyz: Array, skeleton: Skeleton, table: JointCentres, lengths: Array) -> Array:
    """(..., K, 3) from landmarks (..., K, 3) to joint centres; nothing where a direction is unknown."""
    from . import direction_kernels as kernels

    longer = lengths - table.usual
    longer = np.clip(np.where(np.isnan(longer), 0.0, longer), -MOST_LONGER_M, MOST_LONGER_M)
    moves = np.empty(np.shape(xyz))
    flat, flat_moves = (array.reshape(-1, len(skeleton), 3) for array in (xyz, moves))
    metres = table.metres + longer @ table.slopes.T
    metres = np.broadcast_to(metres, (*moves.shape[:-2], metres.shape[-1])).reshape(len(flat), metres.shape[-1])
    # some at a time: directions take several times as much memory as poses
    for start in range(0, len(flat), _PART_POSES):
        part = slice(start, start + _PART_POSES)
        known = body_directions(flat[part], skeleton)
        kernels.moves(known, metres[part].copy(), _FIRST_DIRECTION, _columns(skeleton), flat_moves[part])
    return moves


@cache
def _columns(skeleton: Skeleton) -> Array:
    """(2, J) place of each side's joints on axis K; K where the skeleton lacks one."""
    places = {name: k for k, name in enumerate(skeleton.keypoints)}
    return np.array([[places.get(keypoint_of(side, joint), len(places)) for joint in JOINTS] for side in SIDES])


def joint_directions(xyz: Array, skeleton: Skeleton, side: str) -> Mapping[str, Mapping[str, Array]]:
    """Directions (..., 3) each joint of one side may be moved along, by joint and name, see `body_directions`."""
    known = iter(np.moveaxis(body_directions(xyz, skeleton)[..., SIDES.index(side), :, :], -2, 0))
    return {joint: {name: next(known) for name in names} for joint, names in JOINT_DIRECTIONS.items()}


@dataclass
class _Learnt:
    """Of one person: metres (S,) longer than usual, from how many seconds (S,), up to when."""

    longer: Array
    seconds: Array
    t_ns: int


class LearntLengths:
    """Means over time of the lengths in live poses, drawn to the table's usual ones until they have been seen for long enough.

    So poses do not jump: lengths change gradually from average to measured ones. People who leave are forgotten.
    """

    def __init__(self, table: JointCentres, usual_s: float = USUAL_S) -> None:
        self.table, self._usual_s = table, usual_s
        self._people: dict[int, _Learnt] = {}

    def step(self, pose: Pose3D) -> Array:
        """(N, S) metres of everybody's segments between joint centres, from the landmarks of the next pose and all before."""
        before, self._people = self._people, {}
        for person in pose.person_id.tolist():
            known = before.get(person)
            if known is None or known.t_ns > pose.t_ns:
                known = _Learnt(np.zeros(_S), np.zeros(_S), pose.t_ns)
            self._people[person] = known
        everybody = list(self._people.values())
        due = [n for n, person in enumerate(everybody) if pose.t_ns - person.t_ns >= _EVERY_NS]
        if due:
            centred = at_joint_centres(pose, self.table, self.table.usual)
            seen = lengths_at(_well_known(centred), pose.skeleton)
            for n in due:
                self._learn(everybody[n], seen[n], pose.t_ns)
        return np.array([self.table.usual + person.longer for person in everybody]).reshape(-1, _S)

    def _learn(self, person: _Learnt, seen: Array, t_ns: int) -> None:
        """Both sides' lengths (2, S), NaN where not known, count alike; one wild pose does not count for more than others."""
        new_s = min(t_ns - person.t_ns, _LONGEST_NS) * 1e-9
        person.t_ns = t_ns
        sides = np.isfinite(seen).sum(axis=0)
        longer = np.nansum(seen, axis=0) / np.maximum(sides, 1) - self.table.usual
        away = np.where(sides > 0, np.clip(longer - person.longer, -MOST_LONGER_M, MOST_LONGER_M), 0.0)
        learnt_s = new_s * sides / len(seen)
        person.seconds = np.minimum(person.seconds + learnt_s, _MEMORY_S)
        person.longer = person.longer + away * learnt_s / (self._usual_s + person.seconds)


def _well_known(pose: Pose3D) -> Array:
    """(N, K, 3); NaN where a keypoint was not measured or is too uncertain."""
    variance = np.trace(pose.cov_world, axis1=-2, axis2=-1) / 3
    good = (pose.kind == Kind.FUSED) & (variance < _SURE_M**2)
    return np.where(good[..., None], pose.xyz_world, np.nan)


class ViewsAtJointCentres:
    """A recording's views as if its detector marked joint centres, which is where its 3D is: rays then lead there.

    Each view's keypoints move by what lies between landmark and joint centre in that image, at every time step by the
    offsets in the body's own directions; where the 3D is missing, by as much as before and after. Left and right are named
    as in 3D. Without a table keypoints stay where they are. Views are made for a part of the time steps when it is asked for.
    """

    def __init__(self, poses: PoseSequence, rig: Rig, views: PartsOfViews, table: JointCentres | None) -> None:
        """`poses`: the 3D, at joint centres. `rig`, `views`: of the same people, cameras and times. `table`: of their offsets."""
        self._rig, self._views, self.t_ns = rig, views, poses.t_ns
        self._landmarks = LandmarksInParts(poses.xyz_world, poses.skeleton, table) if table else None
        self._points = poses.xyz_world
        shape = poses.xyz_world.shape
        moves = np.empty((*shape[:2], len(rig), shape[2], 2))
        for part in parts_of_steps(len(poses)):
            moves[part] = self._moves(part, self._marked(part))
        missing = ~np.isfinite(moves)
        _bridge(moves)
        # only those: of an hour, all of them take much memory, and the others are soon made again
        self._missing, self._bridged = np.flatnonzero(missing), moves[missing]

    def part(self, steps: slice) -> ViewSequence:
        """The views of these time steps."""
        seen, landmarks = self._views.part(steps), self._marked(steps)
        named = with_sides_swapped(seen, sides_that_differ(landmarks, self._rig, seen))
        moves = self._moves(steps, landmarks)
        begin = steps.indices(len(self._points))[0] * moves[:1].size
        here = slice(*np.searchsorted(self._missing, [begin, begin + moves.size]))
        moves.reshape(-1)[self._missing[here] - begin] = self._bridged[here]
        return replace(named, xy_img=named.xy_img + moves)

    def _marked(self, steps: slice) -> Array:
        return self._landmarks.part(steps) if self._landmarks else self._points[steps]

    def _moves(self, steps: slice, landmarks: Array) -> Array:
        """(T, N, C, K, 2) pixels from landmark to joint centre; NaN where either is missing."""
        ends = self._points[steps], landmarks
        return np.stack([np.subtract(*map(camera.project, ends)) for camera in self._rig], axis=2)


def _bridge(moves: Array) -> None:
    """Interpolate what is missing of (T, ...) over time, in place; 0 where nothing is known."""
    columns = moves.reshape(len(moves), -1)
    for column in columns.T:
        known = np.isfinite(column)
        column[~known] = np.interp(np.flatnonzero(~known), np.flatnonzero(known), column[known]) if known.any() else 0.0
