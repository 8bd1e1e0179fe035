"""One time step fitted."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel

from .algebra import solve_rows
from .measurements import add, habits, point_information, ray_information
from .tree import derivative, difference, forward_kinematics, place, put_points, retract

CONVERGED = 1e-5


class SeenKeypoints(NamedTuple):
    """What was measured of keypoints (A) in one time step.

    xyz, information: (A, 3), (A, 3, 3) points in the world; projections, xy, inverse_var: (C, 3, 4), (A, C, 2), (A, C) rays.
    """

    xyz: Array
    information: Array
    projections: Array
    xy: Array
    inverse_var: Array


@kernel()
def gauss_newton(tree, expected, expected_information, preferred_sd, seen, robust, repeats, iterations, q, rot):
    """Fit one time step, in place from (q, rot); returns the information (D, D) at the optimum and the iterations used.

    `expected`: the state (q, rot) it is expected in. What was measured counts `repeats` times less than it states, as its error
    is that of as many time steps; whether it is an outlier is judged by what it states.
    """
    hessian, slope = np.empty(expected_information.shape), np.empty(tree.dof[-1])
    used = 0
    _equations(tree, expected, expected_information, preferred_sd, seen, robust, repeats, q, rot, hessian, slope)
    while used < iterations and _stepped(tree, hessian, slope, q, rot):
        used += 1
        _equations(tree, expected, expected_information, preferred_sd, seen, robust, repeats, q, rot, hessian, slope)
    return 0.5 * (hessian + hessian.T), used


@kernel()
def descend(tree, expected, expected_information, preferred_sd, seen, robust, iterations, q, rot, points):
    """As `gauss_newton`, for the pose alone: no equations at its optimum. Leaves the places (A, 3) of the keypoints."""
    hessian, slope = np.empty(expected_information.shape), np.empty(tree.dof[-1])
    for _ in range(iterations):
        _equations(tree, expected, expected_information, preferred_sd, seen, robust, 1.0, q, rot, hessian, slope)
        if not _stepped(tree, hessian, slope, q, rot):
            break
    put_points(tree, q, rot, points)


@kernel()
def _equations(tree, expected, expected_information, preferred_sd, seen, robust, repeats, q, rot, hessian, slope):
    """The normal equations (D, D) and (D,) of one time step about a state."""
    parent, kind, axis, offset, dof, limits, mirrored, node, local = tree
    xyz, information, projections, xy, inverse_var = seen
    q_expected, rot_expected = expected
    frame, origin = np.empty(rot.shape), np.empty((len(q), 3))
    columns, values = np.empty(len(slope), np.int64), np.empty((len(slope), 3))
    gradient, local_information = np.empty(3), np.empty((3, 3))
    forward_kinematics(parent, kind, axis, offset, q, rot, frame, origin)
    hessian[:] = expected_information
    slope[:] = -(expected_information @ difference(kind, dof, q, rot, q_expected, rot_expected))
    habits(kind, dof, preferred_sd, limits, mirrored, q, rot, hessian, slope)
    for p in range(node.shape[0]):
        x = place(frame, origin, node[p], local[p])
        gradient[:] = 0.0
        local_information[:] = 0.0
        if information[p, 0, 0] > 0.0:
            point_information(x, xyz[p], information[p], robust, gradient, local_information)
        ray_information(x, projections, xy[p], inverse_var[p], robust, gradient, local_information)
        if local_information[0, 0] > 0.0:
            gradient /= repeats
            local_information /= repeats
            count = derivative(parent, kind, axis, dof, frame, node[p], x, origin, columns, values)
            add(columns, values, count, gradient, local_information, hessian, slope)


@kernel()
def _stepped(tree, hessian, slope, q, rot):
    """One Gauss-Newton step of the state (q, rot); False where it has converged, which leaves it as it is."""
    step = solve_rows(hessian, slope.reshape(1, -1))[0]
    biggest = np.max(np.abs(step))
    if biggest > 0.5:
        step *= 0.5 / biggest
    if biggest < CONVERGED:
        return False
    retract(tree.kind, tree.dof, step, q, rot)
    return True
