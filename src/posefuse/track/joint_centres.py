"""From what a 2D estimator marks to anatomical joint centres.

A landmark network is consistent, but what it calls a hip is not the centre of the hip joint. The difference is close to
constant in the body's own directions: each joint is moved by fixed lengths along directions built from the fused keypoints
themselves (trunk, limb above, limb below). Lengths are fitted elsewhere and come as a table; see `bench/fit_joint_centres.py`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np

from posefuse.core import ConfigError, Pose3D, PoseSequence, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.files.settings import read_settings, settings

from .body_directions import JOINT_DIRECTIONS, SIDES, body_directions

Poses = TypeVar("Poses", Pose3D, PoseSequence)
JOINTS = tuple(JOINT_DIRECTIONS)
_FIRST_DIRECTION = np.cumsum([0, *(len(names) for names in JOINT_DIRECTIONS.values())])[:-1]
# each round of the inverse leaves two fifths of the error or less: micrometres after these
_INVERSE_ROUNDS = 12


@settings
class JointCentres:
    """Fitted offsets.

    Attributes:
        made_by: command and data of the fit, for people.
        offsets: joint (without its side) -> direction (see `directions`) -> metres.
    """

    made_by: str
    offsets: dict[str, dict[str, float]]


def read_joint_centres(path: Path) -> JointCentres:
    """Read a table; raises ConfigError naming the file, and the joint or direction that does not exist."""
    return check_joint_centres(read_settings(path, JointCentres), str(path))


def check_joint_centres(table: JointCentres, where: str) -> JointCentres:
    """The table; raises ConfigError naming `where`, and the joint or direction that does not exist."""
    for joint, offsets in table.offsets.items():
        if joint not in JOINT_DIRECTIONS:
            raise ConfigError(f"{where}: offsets: no joint {joint!r}; there are: {choices(JOINT_DIRECTIONS)}")
        for name in offsets:
            if name not in JOINT_DIRECTIONS[joint]:
                there = choices(JOINT_DIRECTIONS[joint])
                raise ConfigError(f"{where}: offsets.{joint}: no direction {name!r}; there are: {there}")
    return table


def to_joint_centres(poses: Poses, table: JointCentres) -> Poses:
    """The poses with shoulders, elbows, wrists, hips, knees and ankles moved to their centres.

    A joint stays where it is at instants at which a direction it needs is unknown (a keypoint is missing, or two coincide).
    Covariances stay: the offsets are constants.
    """
    return replace(poses, xyz_world=poses.xyz_world + _moves(poses.xyz_world, poses.skeleton, table))


def from_joint_centres(sequence: PoseSequence, table: JointCentres) -> PoseSequence:
    """What the 2D estimator marks, given joint centres: the inverse of `to_joint_centres`."""
    landmarks = sequence.xyz_world
    for _ in range(_INVERSE_ROUNDS):
        landmarks = sequence.xyz_world - _moves(landmarks, sequence.skeleton, table)
    return replace(sequence, xyz_world=landmarks)


def _moves(xyz: Array, skeleton: Skeleton, table: JointCentres) -> Array:
    """(..., K, 3) from landmarks (..., K, 3) to joint centres; nothing where a direction is unknown."""
    metres = np.array([table.offsets.get(j, {}).get(name, 0.0) for j, names in JOINT_DIRECTIONS.items() for name in names])
    along = np.where(metres[:, None] == 0.0, 0.0, body_directions(xyz, skeleton) * metres[:, None])
    move = np.add.reduceat(along, _FIRST_DIRECTION, axis=-2)
    moves = np.zeros((*xyz.shape[:-2], len(skeleton) + 1, 3))
    moves[..., _columns(skeleton), :] = np.where(np.isfinite(move), move, 0.0)
    return moves[..., :-1, :]


@cache
def _columns(skeleton: Skeleton) -> Array:
    """(2, J) place of each side's joints on axis K; K where the skeleton lacks one."""
    places = {name: k for k, name in enumerate(skeleton.keypoints)}
    return np.array([[places.get(f"{side}_{joint}", len(places)) for joint in JOINTS] for side in SIDES])


def directions(xyz: Array, skeleton: Skeleton, side: str) -> Mapping[str, Mapping[str, Array]]:
    """Directions (..., 3) each joint of one side may be moved along, by joint and name, see `body_directions`."""
    known = iter(np.moveaxis(body_directions(xyz, skeleton)[..., SIDES.index(side), :, :], -2, 0))
    return {joint: {name: next(known) for name in names} for joint, names in JOINT_DIRECTIONS.items()}
