"""A tree of bodies in compiled code: where its keypoints are, its slopes, and the small matrices that this takes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel


# own loops: at these sizes (50 to 100) as quick as BLAS, whose threads fight those of a live session
@kernel(fastmath=True)
def times_transposed(a, b):
    """a @ b^T of C-contiguous (n, k) and (m, k)."""
    out = np.empty((a.shape[0], b.shape[0]))
    for i in range(a.shape[0]):
        for j in range(b.shape[0]):
            total = 0.0
            for k in range(a.shape[1]):
                total += a[i, k] * b[j, k]
            out[i, j] = total
    return out


@kernel()
def solve_rows(a, rows):
    """(m, n) whose every row x solves a x = row, for (n, n); LAPACK solves so few equations in one thread."""
    return np.linalg.solve(a, rows.T).T


@kernel()
def inverse(a):
    """Inverse of a symmetric positive definite matrix, symmetric to the last bit."""
    out = solve_rows(a, np.eye(a.shape[0]))
    return 0.5 * (out + out.T)


SLIDE, HINGE, BALL = 0, 1, 2


class Tree(NamedTuple):
    """A body as the kernels want it: nodes (n, ...) with the place `dof` (n + 1,) of their freedom, and keypoints (A, ...).

    slack_var, accel: (D,) constants of motion.
    """

    parent: Array
    kind: Array
    axis: Array
    offset: Array
    dof: Array
    limits: Array
    mirrored: Array
    node: Array
    local: Array
    preferred_sd: Array
    slack_var: Array
    accel: Array

    @property
    def size(self) -> int:
        """D."""
        return int(self.dof[-1])

    def held(self, information: float) -> Array:
        """(D, D) information that holds what gives way near zero by its own spread, and all else by this."""
        slack = self.slack_var > 0
        return np.diag(np.where(slack, 1 / np.where(slack, self.slack_var, 1.0), information))


@kernel()
def exp3(v):
    """Rotation matrix of a rotation vector."""
    angle = math.sqrt(v[0] ** 2 + v[1] ** 2 + v[2] ** 2)
    a = math.sin(angle) / angle if angle > 1e-8 else 1.0
    b = (1.0 - math.cos(angle)) / (angle * angle) if angle > 1e-6 else 0.5
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = b * v[i] * v[j]
        out[i, i] += math.cos(angle) if angle > 1e-6 else 1.0 - 0.5 * angle * angle
    out[0, 1] -= a * v[2]
    out[0, 2] += a * v[1]
    out[1, 0] += a * v[2]
    out[1, 2] -= a * v[0]
    out[2, 0] -= a * v[1]
    out[2, 1] += a * v[0]
    return out


@kernel()
def log3(r):
    """Rotation vector of a rotation matrix, angle below pi."""
    out = np.empty(3)
    out[0], out[1], out[2] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    sine = 0.5 * math.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    cosine = 0.5 * (r[0, 0] + r[1, 1] + r[2, 2] - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-7:
        return out * (0.5 * angle / sine)
    if cosine > 0.0:
        return 0.5 * out
    axis = np.empty(3)
    for i in range(3):
        axis[i] = math.sqrt(max(0.0, 0.5 * (r[i, i] + 1.0)))
    biggest = np.argmax(axis)
    for i in range(3):
        if i != biggest and r[biggest, i] + r[i, biggest] < 0.0:
            axis[i] = -axis[i]
    return axis * math.pi


@kernel()
def forward_kinematics(tree, q, rot, frame, origin):
    """World rotation and origin of every node."""
    parent, kind, axis = tree.parent, tree.kind, tree.axis
    step = np.empty(3)
    turn = np.empty((3, 3))
    for n in range(parent.shape[0]):
        p = parent[n]
        for i in range(3):
            step[i] = tree.offset[n, i]
        if kind[n] == SLIDE:
            step[axis[n]] += q[n]
        if kind[n] == BALL:
            turn[:] = rot[n]
        else:
            turn[:] = 0.0
            for i in range(3):
                turn[i, i] = 1.0
            if kind[n] == HINGE:
                i, j = (axis[n] + 1) % 3, (axis[n] + 2) % 3
                c, s = math.cos(q[n]), math.sin(q[n])
                turn[i, i], turn[j, j], turn[j, i], turn[i, j] = c, c, s, -s
        if p < 0:
            origin[n] = step
            frame[n] = turn
        else:
            for i in range(3):
                origin[n, i] = origin[p, i]
                for j in range(3):
                    origin[n, i] += frame[p, i, j] * step[j]
                    frame[n, i, j] = 0.0
                    for k in range(3):
                        frame[n, i, j] += frame[p, i, k] * turn[k, j]


@kernel()
def place(frame, origin, node, local):
    """World place (3,) of a point fixed to a node."""
    out = origin[node].copy()
    for i in range(3):
        for j in range(3):
            out[i] += frame[node, i, j] * local[j]
    return out


@kernel()
def put_points(tree, q, rot, out):
    """Fill the places (A, 3) of the tree's keypoints."""
    frame, origin = np.empty(rot.shape), np.empty((len(q), 3))
    forward_kinematics(tree, q, rot, frame, origin)
    for p in range(len(out)):
        out[p] = place(frame, origin, tree.node[p], tree.local[p])


@kernel()
def derivative(tree, frame, node, x, origin, columns, values):
    """Columns of d(point)/d(state) that are not zero: their places and values (n, 3); returns how many.

    The rotation axis of a hinge and the direction of a slide are the same in the node's own frame as in its parent's.
    """
    kind, count, n = tree.kind, 0, node
    while n >= 0:
        rx, ry, rz = x[0] - origin[n, 0], x[1] - origin[n, 1], x[2] - origin[n, 2]
        for k in range(3 if kind[n] == BALL else 1):
            a = k if kind[n] == BALL else tree.axis[n]
            ax, ay, az = frame[n, 0, a], frame[n, 1, a], frame[n, 2, a]
            columns[count] = tree.dof[n] + k
            if kind[n] == SLIDE:
                values[count, 0], values[count, 1], values[count, 2] = ax, ay, az
            else:
                values[count, 0] = ay * rz - az * ry
                values[count, 1] = az * rx - ax * rz
                values[count, 2] = ax * ry - ay * rx
            count += 1
        n = tree.parent[n]
    return count


@kernel()
def _turned(a, b, back):
    """a @ b, or a^T @ b where it is to be turned `back`; own loops, as a call of BLAS takes longer than a product of (3, 3)."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = 0.0
            for k in range(3):
                out[i, j] += (a[k, i] if back else a[i, k]) * b[k, j]
    return out


@kernel()
def retract(tree, step, q, rot):
    """Move a state by local coordinates (D,), in place."""
    dof = tree.dof
    for n in range(len(q)):
        if tree.kind[n] == BALL:
            rot[n] = _turned(rot[n], exp3(step[dof[n] : dof[n] + 3]), False)
        else:
            q[n] += step[dof[n]]


@kernel()
def difference(tree, q, rot, q_from, rot_from):
    """Local coordinates (D,) that move the state `from` to the first."""
    dof = tree.dof
    out = np.empty(dof[-1])
    for n in range(len(q)):
        if tree.kind[n] == BALL:
            out[dof[n] : dof[n] + 3] = log3(_turned(rot_from[n], rot[n], True))
        else:
            out[dof[n]] = q[n] - q_from[n]
    return out


@kernel()
def keypoints(tree, q, rot, frame, origin, points, jacobians):
    """Places (A, 3) of the tree's keypoints and their derivatives (A, 3, D); leaves frames and origins of the nodes."""
    forward_kinematics(tree, q, rot, frame, origin)
    columns, values = np.empty(tree.dof[-1], np.int64), np.empty((tree.dof[-1], 3))
    jacobians[:] = 0.0
    for p in range(len(points)):
        points[p] = place(frame, origin, tree.node[p], tree.local[p])
        count = derivative(tree, frame, tree.node[p], points[p], origin, columns, values)
        for a in range(count):
            for i in range(3):
                jacobians[p, i, columns[a]] = values[a, i]
