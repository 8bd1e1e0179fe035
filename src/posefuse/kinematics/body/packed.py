"""A body as the arrays the compiled code wants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array

from . import kernels
from .model import BodyModel, degrees_of_freedom
from .settings import BodySettings
from .tree import BALL, SLIDE, Node

HABIT_S = 1.0  # a preference counts as one measurement in this time
SLACK_S = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class Packed:
    """The tree of one body, and its constants of motion, as arrays (nodes, ...) and (D, ...)."""

    tree: kernels.Tree
    preferred_sd: Array
    slack_var: Array
    accel: Array

    @property
    def size(self) -> int:
        """D."""
        return int(self.tree.dof[-1])


def packed_from_body(body: BodyModel, settings: BodySettings) -> Packed:
    """Arrays of a body; limits and preferences from the settings."""
    nodes = body.nodes
    names = [node.name for node in nodes]
    dof = degrees_of_freedom(nodes)
    slack_var, accel = np.zeros(dof[-1]), np.full(dof[-1], settings.turn_accel_rad_s15)
    for n, node in enumerate(nodes):
        if node.slack:
            slack_var[dof[n]] = node.sd**2
        elif node.kind == SLIDE:
            accel[dof[n]] = settings.move_accel_m_s15
    tree = kernels.Tree(
        parent=np.array([names.index(node.parent) if node.parent else -1 for node in nodes]),
        kind=np.array([node.kind for node in nodes]),
        axis=np.array([node.axis for node in nodes]),
        offset=np.ascontiguousarray(body.offset),
        dof=dof,
        limits=np.array([_limits(node, settings.joint_limits) for node in nodes]),
        mirrored=np.array([node.name.startswith("left_") for node in nodes]),
        node=body.keypoint_node,
        local=np.ascontiguousarray(body.keypoint_local),
    )
    preferred_sd = np.array([np.inf if node.slack else node.sd for node in nodes])
    return Packed(tree=tree, preferred_sd=preferred_sd, slack_var=slack_var, accel=accel)


def _limits(node: Node, wanted: bool) -> Array:
    """(3, 2) low and high; (1, 0) where there is none. A left hinge about X or Y turns the other way."""
    out = np.tile([1.0, 0.0], (3, 1))
    if wanted and node.limits:
        out[: len(node.limits)] = node.limits
        if node.kind != BALL and node.axis != 2 and node.name.startswith("left_"):
            out[0] = -out[0, ::-1]
    return out
