"""The compiled mathematics of the whole-body fit: Gauss-Newton step, filter, smoother, and what only a live fit needs.

State of one time step: q (nodes,) of slides and hinges, rot (nodes, 3, 3) of balls; its error lives in D local coordinates,
a ball's as a rotation vector in its own child axes (rot <- rot exp(d)). The filter's covariance is over (D errors,
D velocities). A keypoint's measurement of any kind is brought to information (3, 3) and gradient (3,) about its present
place, so that 3D points and the rays of all cameras enter the same normal equations.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.compiled import kernel
from posefuse.kinematics.body.tree_kernels import (
    BALL,
    derivative,
    difference,
    forward_kinematics,
    log3,
    place,
    retract,
    solve_rows,
    times_transposed,
)

# What points, rays, habits and limits of joints add to the normal equations.

LIMIT_SD = 0.03


@kernel()
def point_information(x, seen, information, robust, gradient, out):
    """Student-t weighted information of a measured 3D point about the place x; returns its squared distance."""
    distance = 0.0
    pulled = np.zeros(3)
    for i in range(3):
        for j in range(3):
            pulled[i] += information[i, j] * (seen[j] - x[j])
        distance += (seen[i] - x[i]) * pulled[i]
    weight = (robust + 3.0) / (robust + distance)
    for i in range(3):
        gradient[i] += weight * pulled[i]
        for j in range(3):
            out[i, j] += weight * information[i, j]
    return distance


@kernel()
def ray_information(x, projections, xy, inverse_var, robust, gradient, out):
    """The same of undistorted pixels (C, 2) in cameras (C, 3, 4); cameras with no information count nothing."""
    jacobian = np.empty((2, 3))
    for c in range(projections.shape[0]):
        if not inverse_var[c] > 0.0:
            continue
        m = projections[c]
        u = m[0, 0] * x[0] + m[0, 1] * x[1] + m[0, 2] * x[2] + m[0, 3]
        v = m[1, 0] * x[0] + m[1, 1] * x[1] + m[1, 2] * x[2] + m[1, 3]
        w = m[2, 0] * x[0] + m[2, 1] * x[1] + m[2, 2] * x[2] + m[2, 3]
        if w <= 0.0:
            continue
        u, v = u / w, v / w
        for i in range(3):
            jacobian[0, i] = (m[0, i] - u * m[2, i]) / w
            jacobian[1, i] = (m[1, i] - v * m[2, i]) / w
        e, f = xy[c, 0] - u, xy[c, 1] - v
        weight = inverse_var[c] * (robust + 2.0) / (robust + (e * e + f * f) * inverse_var[c])
        for i in range(3):
            gradient[i] += weight * (jacobian[0, i] * e + jacobian[1, i] * f)
            for j in range(3):
                out[i, j] += weight * (jacobian[0, i] * jacobian[0, j] + jacobian[1, i] * jacobian[1, j])


@kernel()
def add(columns, values, count, gradient, information, hessian, slope):
    """Add J^T information J and J^T gradient of one point."""
    carried = np.empty(3)
    for a in range(count):
        for i in range(3):
            carried[i] = information[i, 0] * values[a, 0] + information[i, 1] * values[a, 1] + information[i, 2] * values[a, 2]
        slope[columns[a]] += gradient[0] * values[a, 0] + gradient[1] * values[a, 1] + gradient[2] * values[a, 2]
        for b in range(count):
            hessian[columns[a], columns[b]] += carried[0] * values[b, 0] + carried[1] * values[b, 1] + carried[2] * values[b, 2]


@kernel()
def _pull(hessian, slope, at, residual, sd):
    hessian[at, at] += 1.0 / (sd * sd)
    slope[at] += residual / (sd * sd)


@kernel()
def habits(tree, looser, q, rot, hessian, slope):
    """What humans do not do: preferences for zero of unlimited spread per second, and soft ends of each range.

    looser: what the standard deviations of the preferences are multiplied by.
    """
    dof, limits = tree.dof, tree.limits
    for n in range(len(q)):
        sd = tree.preferred_sd[n] * looser
        if tree.kind[n] == BALL:
            if sd < np.inf:
                turned = log3(rot[n])
                for k in range(3):
                    _pull(hessian, slope, dof[n] + k, -turned[k], sd)
            if limits[n, 0, 0] < limits[n, 0, 1]:
                _ball_limits(rot[n], dof[n], limits[n], tree.mirrored[n], hessian, slope)
            continue
        if sd < np.inf:
            _pull(hessian, slope, dof[n], -q[n], sd)
        if limits[n, 0, 0] < limits[n, 0, 1]:
            over = max(0.0, q[n] - limits[n, 0, 1]) + min(0.0, q[n] - limits[n, 0, 0])
            if over != 0.0:
                _pull(hessian, slope, dof[n], -over, LIMIT_SD)


@kernel()
def _ball_limits(r, at, limits, mirrored, hessian, slope):
    """Soft limits on the three ZXY angles of a ball joint, mirrored on the left.

    Without them hips turn by half a turn: 13 % of the knees of a walk with errors of 30 mm are bent backwards, with them 2.5 %.
    """
    sign = -1.0 if mirrored else 1.0
    cosine = math.hypot(r[2, 0], r[2, 2])
    if cosine < 0.2:
        return
    angles = (math.atan2(-r[0, 1], r[1, 1]), sign * math.atan2(r[2, 1], cosine), sign * math.atan2(-r[2, 0], r[2, 2]))
    over = np.empty(3)
    for k in range(3):
        over[k] = max(0.0, angles[k] - limits[k, 1]) + min(0.0, angles[k] - limits[k, 0])
    if not over.any():
        return
    axes = np.zeros((3, 3))
    axes[2, 0] = 1.0
    axes[0, 1], axes[1, 1] = sign * math.cos(angles[0]), sign * math.sin(angles[0])
    axes[:, 2] = sign * r[:, 1]
    rates = np.linalg.inv(axes) @ r
    for k in range(3):
        if over[k] != 0.0:
            for i in range(3):
                slope[at + i] -= rates[k, i] * over[k] / (LIMIT_SD * LIMIT_SD)
                for j in range(3):
                    hessian[at + i, at + j] += rates[k, i] * rates[k, j] / (LIMIT_SD * LIMIT_SD)


# Information of the rays of one time step about segment lengths, with the pose re-fitted to them.


@kernel()
def length_information(
    points, by_state, by_length, projections, xy, inverse_var, robust, information, out_information, out_slope
):
    """Add to the normal equations of the lengths, (S, S) and (S,), with the state (D) eliminated.

    points (A, 3) at the optimum of the state, whose information (D, D) that is; derivatives by_state (A, 3, D) and by_length
    (A, 3, S); rays as for `ray_information`.
    """
    size, lengths = by_state.shape[2], by_length.shape[2]
    mixed = np.zeros((lengths, size))
    own = np.zeros((lengths, lengths))
    gradient = np.empty(3)
    local = np.empty((3, 3))
    for p in range(points.shape[0]):
        gradient[:] = 0.0
        local[:] = 0.0
        ray_information(points[p], projections, xy[p], inverse_var[p], robust, gradient, local)
        pulled = by_length[p].T.copy() @ local
        own += pulled @ by_length[p]
        mixed += pulled @ by_state[p]
        for s in range(lengths):
            for i in range(3):
                out_slope[s] += by_length[p, i, s] * gradient[i]
    out_information += own - mixed @ np.linalg.solve(information, mixed.T.copy())


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
def gauss_newton(tree, expected, expected_information, looser, seen, robust, repeats, iterations, q, rot):
    """`descend`, and the information (D, D) where it ends."""
    hessian, slope = np.empty(expected_information.shape), np.empty(tree.dof[-1])
    descend(tree, expected, expected_information, looser, seen, robust, repeats, iterations, q, rot)
    _equations(tree, expected, expected_information, looser, seen, robust, repeats, q, rot, hessian, slope)
    return 0.5 * (hessian + hessian.T)


@kernel()
def descend(tree, expected, expected_information, looser, seen, robust, repeats, iterations, q, rot):
    """Fit one time step, in place from (q, rot).

    `expected`: the state (q, rot) it is expected in. `looser`: see `habits`. What was measured counts `repeats` times less than
    it states, as its error is that of as many time steps; whether it is an outlier is judged by what it states.
    """
    hessian, slope = np.empty(expected_information.shape), np.empty(tree.dof[-1])
    for _ in range(iterations):
        _equations(tree, expected, expected_information, looser, seen, robust, repeats, q, rot, hessian, slope)
        if not _stepped(tree, hessian, slope, q, rot):
            break


@kernel()
def _equations(tree, expected, expected_information, looser, seen, robust, repeats, q, rot, hessian, slope):
    """The normal equations (D, D) and (D,) of one time step about a state."""
    xyz, information, projections, xy, inverse_var = seen
    q_expected, rot_expected = expected
    frame, origin = np.empty(rot.shape), np.empty((len(q), 3))
    columns, values = np.empty(len(slope), np.int64), np.empty((len(slope), 3))
    gradient, local_information = np.empty(3), np.empty((3, 3))
    forward_kinematics(tree, q, rot, frame, origin)
    hessian[:] = expected_information
    slope[:] = -(expected_information @ difference(tree, q, rot, q_expected, rot_expected))
    habits(tree, looser, q, rot, hessian, slope)
    for p in range(len(xyz)):
        x = place(frame, origin, tree.node[p], tree.local[p])
        gradient[:] = 0.0
        local_information[:] = 0.0
        if information[p, 0, 0] > 0.0:
            point_information(x, xyz[p], information[p], robust, gradient, local_information)
        ray_information(x, projections, xy[p], inverse_var[p], robust, gradient, local_information)
        if local_information[0, 0] > 0.0:
            gradient /= repeats
            local_information /= repeats
            count = derivative(tree, frame, tree.node[p], x, origin, columns, values)
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
    retract(tree, step, q, rot)
    return True


@kernel()
def predict(tree, elapsed_s, memory_s, slack_memory_s, q, rot, velocity, cov):
    """Carry state, velocity (D,) and covariance (2D, 2D) over a time; in place. Returns the transition's three diagonals.

    Velocities fade (Ornstein-Uhlenbeck) with white acceleration; slack falls back to zero with its own stationary spread.
    """
    size, slack_var = tree.dof[-1], tree.slack_var
    decay = math.exp(-elapsed_s / memory_s)
    forget = math.exp(-elapsed_s / slack_memory_s)
    slack = slack_var > 0.0
    keep, drift, fade = np.where(slack, forget, 1.0), np.where(slack, 0.0, memory_s * (1.0 - decay)), np.where(slack, 0.0, decay)
    step = drift * velocity
    for n in range(len(q)):
        if tree.kind[n] != BALL and slack_var[tree.dof[n]] > 0.0:
            q[n] *= forget
    retract(tree, step, q, rot)
    velocity *= fade
    cov[:] = _carried(_carried(cov, keep, drift, fade).T, keep, drift, fade)
    for d in range(size):
        if slack_var[d] > 0.0:
            cov[d, d] += slack_var[d] * (1.0 - forget * forget)
            cov[size + d, size + d] = 1e-12
        else:
            power = tree.accel[d] ** 2
            cov[d, d] += power * elapsed_s**3 / 3.0
            cov[d, size + d] += power * elapsed_s**2 / 2.0
            cov[size + d, d] += power * elapsed_s**2 / 2.0
            cov[size + d, size + d] += power * elapsed_s
    return keep, drift, fade


@kernel()
def _carried(cov, keep, drift, fade):
    """F cov with the transition F = [[diag(keep), diag(drift)], [0, diag(fade)]]."""
    n, out = len(keep), np.empty(cov.shape)
    for i in range(n):
        out[i] = keep[i] * cov[i] + drift[i] * cov[n + i]
        out[n + i] = fade[i] * cov[n + i]
    return out


@kernel()
def absorb(cov, expected_information, posterior, step, velocity):
    """Measurement update of covariance (2D, 2D) and velocity, in place, given the new covariance and step of the state."""
    n = step.shape[0]
    gain = times_transposed(cov[n:, :n].copy(), expected_information)
    velocity += gain @ step
    across = times_transposed(gain, cov[:n, :n] - posterior)
    cov[n:, n:] -= times_transposed(across, gain)
    # an antisymmetric part, however small, would grow from step to step
    cov[n:, n:] = 0.5 * (cov[n:, n:] + cov[n:, n:].copy().T)
    cov[n:, :n] = times_transposed(gain, posterior)
    cov[:n, n:] = cov[n:, :n].T.copy()
    cov[:n, :n] = posterior


@kernel()
def smooth_step(cov, keep, drift, fade, cov_expected, cov_next, change):
    """One backward step (Rauch, Tung, Striebel): the change (2D,) of the filtered state and its smoothed covariance."""
    cross = _carried(cov, keep, drift, fade).T
    gain = solve_rows(cov_expected, cross)
    moved = gain @ change
    smoothed = cov + times_transposed(times_transposed(gain, cov_next - cov_expected), gain)
    return moved, 0.5 * (smoothed + smoothed.T)


@kernel()
def stand(xyz, elapsed_s, rules, last, place, off, velocity, slow_s, stands):
    """Points (R, 3) of soles: what hardly moves stands at its mean place; see `standing.StandingFeet`.

    Everything from `last` on is what is remembered of each point, changed in place. rules: limit of the speed in m/s, how long it
    must have held in s, time over which speed is a mean in s, farthest from the place in m, time in which a foot that lifts
    comes back to where it is tracked in s.
    """
    slow_m_s, least_s, speed_s, left_m, fade_s = rules
    fresh, kept = 1.0 - math.exp(-elapsed_s / speed_s), math.exp(-elapsed_s / fade_s)
    for r in range(xyz.shape[0]):
        known = elapsed_s > 0.0 and math.isfinite(xyz[r, 0]) and math.isfinite(last[r, 0])
        speed, away = 0.0, 0.0
        for i in range(3):
            if known:
                velocity[r, i] += fresh * ((xyz[r, i] - last[r, i]) / elapsed_s - velocity[r, i])
            else:
                velocity[r, i] = 0.0
            speed += velocity[r, i] ** 2
            away += (xyz[r, i] - place[r, i]) ** 2
        slow = known and speed < slow_m_s**2 and away < left_m**2
        slow_s[r] = slow_s[r] + elapsed_s if slow else 0.0
        stands[r] = slow_s[r] >= least_s
        for i in range(3):
            if slow:
                place[r, i] += elapsed_s / slow_s[r] * (xyz[r, i] - place[r, i])
            else:
                place[r, i] = xyz[r, i]
            off[r, i] = place[r, i] - xyz[r, i] if stands[r] else kept * off[r, i]
            last[r, i] = xyz[r, i]
