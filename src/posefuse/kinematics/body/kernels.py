"""The compiled mathematics of the whole-body fit: tree, Gauss-Newton step, filter and smoother.

State of one instant: q (nodes,) of slides and hinges, rot (nodes, 3, 3) of balls; its error lives in D local coordinates,
a ball's as a rotation vector in its own child axes (rot <- rot exp(d)). The filter's covariance is over (D errors,
D velocities). A keypoint's measurement of any kind is brought to information (3, 3) and gradient (3,) about its present
place, so that 3D points and the rays of all cameras enter the same normal equations.
"""

from __future__ import annotations

import math

import numpy as np

from posefuse.files.compiled import kernel

SLIDE, HINGE, BALL = 0, 1, 2
LIMIT_SD = 0.03
CONVERGED = 1e-5
# own loops for the dense algebra: at these sizes (50 to 100) as quick as BLAS, whose threads fight those of a live session
_DENSE = {"fastmath": True}


@kernel(**_DENSE)
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


@kernel(**_DENSE)
def cholesky(a):
    """Lower factor of a symmetric positive definite matrix."""
    n = a.shape[0]
    lower = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            lower[i, j] = math.sqrt(total) if i == j else total / lower[j, j]
    return lower


@kernel(**_DENSE)
def solve_rows(a, rows):
    """(m, n) whose every row x solves a x = row, for a symmetric positive definite (n, n)."""
    lower = cholesky(a)
    upper = np.ascontiguousarray(lower.T)
    out = np.empty(rows.shape)
    n = a.shape[0]
    for r in range(rows.shape[0]):
        x = out[r]
        for i in range(n):
            total = rows[r, i]
            for k in range(i):
                total -= lower[i, k] * x[k]
            x[i] = total / lower[i, i]
        for i in range(n - 1, -1, -1):
            total = x[i]
            for k in range(i + 1, n):
                total -= upper[i, k] * x[k]
            x[i] = total / lower[i, i]
    return out


@kernel()
def inverse(a):
    """Inverse of a symmetric positive definite matrix, symmetric to the last bit."""
    out = solve_rows(a, np.eye(a.shape[0]))
    return 0.5 * (out + out.T)


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
def forward(parent, kind, axis, offset, q, rot, frame, origin):
    """World rotation and origin of every node."""
    step = np.empty(3)
    turn = np.empty((3, 3))
    for n in range(parent.shape[0]):
        p = parent[n]
        for i in range(3):
            step[i] = offset[n, i]
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
def derivative(parent, kind, axis, dof, frame, node, x, origin, columns, values):
    """Columns of d(point)/d(state) that are not zero: their places and values (n, 3); returns how many.

    The rotation axis of a hinge and the direction of a slide are the same in the node's own frame as in its parent's.
    """
    count = 0
    n = node
    while n >= 0:
        rx, ry, rz = x[0] - origin[n, 0], x[1] - origin[n, 1], x[2] - origin[n, 2]
        for k in range(3 if kind[n] == BALL else 1):
            a = k if kind[n] == BALL else axis[n]
            ax, ay, az = frame[n, 0, a], frame[n, 1, a], frame[n, 2, a]
            columns[count] = dof[n] + k
            if kind[n] == SLIDE:
                values[count, 0], values[count, 1], values[count, 2] = ax, ay, az
            else:
                values[count, 0] = ay * rz - az * ry
                values[count, 1] = az * rx - ax * rz
                values[count, 2] = ax * ry - ay * rx
            count += 1
        n = parent[n]
    return count


@kernel()
def retract(kind, dof, step, q, rot):
    """Move a state by local coordinates (D,), in place."""
    for n in range(kind.shape[0]):
        if kind[n] == BALL:
            rot[n] = rot[n] @ exp3(step[dof[n] : dof[n] + 3])
        else:
            q[n] += step[dof[n]]


@kernel()
def difference(kind, dof, q, rot, q_from, rot_from):
    """Local coordinates (D,) that move the state `from` to the first."""
    out = np.empty(dof[-1])
    for n in range(kind.shape[0]):
        if kind[n] == BALL:
            out[dof[n] : dof[n] + 3] = log3(rot_from[n].T @ rot[n])
        else:
            out[dof[n]] = q[n] - q_from[n]
    return out


@kernel()
def point_information(x, seen, information, robust, gradient, out):
    """Student-t weighted information of a measured 3D point about the place x; returns its squared distance."""
    d = seen - x
    pulled = information @ d
    distance = d[0] * pulled[0] + d[1] * pulled[1] + d[2] * pulled[2]
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
def _add(columns, values, count, gradient, information, hessian, slope):
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
def _habits(kind, dof, preferred_sd, limits, mirrored, q, rot, hessian, slope):
    """What humans do not do: preferences for zero of unlimited spread per second, and soft ends of each range."""
    for n in range(kind.shape[0]):
        if kind[n] == BALL:
            if preferred_sd[n] < np.inf:
                turned = log3(rot[n])
                for k in range(3):
                    _pull(hessian, slope, dof[n] + k, -turned[k], preferred_sd[n])
            if limits[n, 0, 0] < limits[n, 0, 1]:
                _ball_limits(rot[n], dof[n], limits[n], mirrored[n], hessian, slope)
            continue
        if preferred_sd[n] < np.inf:
            _pull(hessian, slope, dof[n], -q[n], preferred_sd[n])
        if limits[n, 0, 0] < limits[n, 0, 1]:
            over = max(0.0, q[n] - limits[n, 0, 1]) + min(0.0, q[n] - limits[n, 0, 0])
            if over != 0.0:
                _pull(hessian, slope, dof[n], -over, LIMIT_SD)


@kernel()
def _ball_limits(r, at, limits, mirrored, hessian, slope):
    """Soft limits on the three ZXY angles of a ball joint, mirrored on the left."""
    sign = -1.0 if mirrored else 1.0
    cosine = math.hypot(r[2, 0], r[2, 2])
    if cosine < 0.2:
        return
    angles = (math.atan2(-r[0, 1], r[1, 1]), sign * math.atan2(r[2, 1], cosine), sign * math.atan2(-r[2, 0], r[2, 2]))
    axes = np.zeros((3, 3))
    axes[2, 0] = 1.0
    axes[0, 1], axes[1, 1] = sign * math.cos(angles[0]), sign * math.sin(angles[0])
    axes[:, 2] = sign * r[:, 1]
    rates = np.linalg.inv(axes) @ r
    for k in range(3):
        over = max(0.0, angles[k] - limits[k, 1]) + min(0.0, angles[k] - limits[k, 0])
        if over != 0.0:
            for i in range(3):
                slope[at + i] -= rates[k, i] * over / (LIMIT_SD * LIMIT_SD)
                for j in range(3):
                    hessian[at + i, at + j] += rates[k, i] * rates[k, j] / (LIMIT_SD * LIMIT_SD)


@kernel()
def gauss_newton(
    parent, kind, axis, offset, dof, limits, mirrored, node, local, q_expected, rot_expected, expected_information,
    preferred_sd, seen, information, projections, xy, inverse_var, robust, iterations, q, rot,
):  # fmt: skip
    """Fit one instant, in place from (q, rot); returns the information (D, D) at the optimum and the iterations used."""
    size = dof[-1]
    frame = np.empty((kind.shape[0], 3, 3))
    origin = np.empty((kind.shape[0], 3))
    columns = np.empty(size, np.int64)
    values = np.empty((size, 3))
    gradient = np.empty(3)
    local_information = np.empty((3, 3))
    hessian = np.empty((size, size))
    used = 0
    for _ in range(iterations + 1):
        forward(parent, kind, axis, offset, q, rot, frame, origin)
        hessian[:] = expected_information
        slope = -(expected_information @ difference(kind, dof, q, rot, q_expected, rot_expected))
        _habits(kind, dof, preferred_sd, limits, mirrored, q, rot, hessian, slope)
        for p in range(node.shape[0]):
            x = place(frame, origin, node[p], local[p])
            gradient[:] = 0.0
            local_information[:] = 0.0
            if information[p, 0, 0] > 0.0:
                point_information(x, seen[p], information[p], robust, gradient, local_information)
            ray_information(x, projections, xy[p], inverse_var[p], robust, gradient, local_information)
            if local_information[0, 0] > 0.0:
                count = derivative(parent, kind, axis, dof, frame, node[p], x, origin, columns, values)
                _add(columns, values, count, gradient, local_information, hessian, slope)
        if used == iterations:
            break
        step = solve_rows(hessian, slope.reshape(1, -1))[0]
        biggest = np.max(np.abs(step))
        if biggest > 0.5:
            step *= 0.5 / biggest
        if biggest < CONVERGED:
            break
        retract(kind, dof, step, q, rot)
        used += 1
    return 0.5 * (hessian + hessian.T), used


@kernel()
def predict(kind, dof, slack_var, accel, elapsed_s, memory_s, slack_memory_s, q, rot, velocity, cov):
    """Carry state, velocity (D,) and covariance (2D, 2D) over a time; in place. Returns the transition's three diagonals.

    Velocities fade (Ornstein-Uhlenbeck) with white acceleration; slack falls back to zero with its own stationary spread.
    """
    size = dof[-1]
    keep = np.ones(size)
    drift = np.zeros(size)
    fade = np.zeros(size)
    decay = math.exp(-elapsed_s / memory_s)
    forget = math.exp(-elapsed_s / slack_memory_s)
    for d in range(size):
        if slack_var[d] > 0.0:
            keep[d] = forget
        else:
            drift[d], fade[d] = memory_s * (1.0 - decay), decay
    step = drift * velocity
    for n in range(kind.shape[0]):
        if kind[n] != BALL and slack_var[dof[n]] > 0.0:
            q[n] *= forget
    retract(kind, dof, step, q, rot)
    velocity *= fade
    _spread(cov, keep, drift, fade)
    for d in range(size):
        if slack_var[d] > 0.0:
            cov[d, d] += slack_var[d] * (1.0 - forget * forget)
            cov[size + d, size + d] = 1e-12
        else:
            power = accel[d] ** 2
            cov[d, d] += power * elapsed_s**3 / 3.0
            cov[d, size + d] += power * elapsed_s**2 / 2.0
            cov[size + d, d] += power * elapsed_s**2 / 2.0
            cov[size + d, size + d] += power * elapsed_s
    return keep, drift, fade


@kernel()
def _spread(cov, keep, drift, fade):
    """F cov F^T in place, F = [[diag(keep), diag(drift)], [0, diag(fade)]]."""
    n = keep.shape[0]
    for i in range(n):
        for j in range(2 * n):
            cov[i, j] = keep[i] * cov[i, j] + drift[i] * cov[n + i, j]
            cov[n + i, j] *= fade[i]
    for j in range(n):
        for i in range(2 * n):
            cov[i, j] = keep[j] * cov[i, j] + drift[j] * cov[i, n + j]
            cov[i, n + j] *= fade[j]


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
    n = keep.shape[0]
    cross = cov.copy()
    for j in range(n):
        for i in range(2 * n):
            cross[i, j] = keep[j] * cov[i, j] + drift[j] * cov[i, n + j]
            cross[i, n + j] = fade[j] * cov[i, n + j]
    gain = solve_rows(cov_expected, cross)
    moved = gain @ change
    smoothed = cov + times_transposed(times_transposed(gain, cov_next - cov_expected), gain)
    return moved, 0.5 * (smoothed + smoothed.T)


@kernel()
def keypoints(parent, kind, axis, offset, dof, node, local, q, rot, frame, origin, points, jacobians):
    """Places (A, 3) of the tree's keypoints and their derivatives (A, 3, D); leaves frames and origins of the nodes."""
    forward(parent, kind, axis, offset, q, rot, frame, origin)
    columns = np.empty(dof[-1], np.int64)
    values = np.empty((dof[-1], 3))
    jacobians[:] = 0.0
    for p in range(node.shape[0]):
        points[p] = place(frame, origin, node[p], local[p])
        count = derivative(parent, kind, axis, dof, frame, node[p], points[p], origin, columns, values)
        for a in range(count):
            for i in range(3):
                jacobians[p, i, columns[a]] = values[a, i]


@kernel()
def add_point_variance(weights, rows, jacobians, cov, sigmas):
    """Add to sigmas (J, 3) what errors of the state do through the landmarks: weights (J, P, 3, 3) of each angle."""
    size = cov.shape[0]
    for q in range(weights.shape[0]):
        for a in range(3):
            if math.isnan(sigmas[q, a]):
                continue
            g = np.zeros(size)
            for p in range(rows.shape[0]):
                for half in range(2):
                    r = rows[p, half]
                    if r < 0:
                        continue
                    for i in range(3):
                        w = 0.5 * weights[q, p, a, i]
                        if w != 0.0:
                            g += w * jacobians[r, i]
            sigmas[q, a] = math.sqrt(sigmas[q, a] ** 2 + g @ (cov @ g))
