"""The compiled mathematics of the asynchronous tracker: one view of one person at a time.

Every keypoint has M motion models side by side (interacting multiple models, Blom & Bar-Shalom 1988), from calm to agile.
Each is a Kalman filter of position, velocity, acceleration (9), where acceleration fades (Singer 1970); a view is one ray,
two rows.

A state is one flat float64 array, so that keeping one per view is one copy: `parts` names what lies in it. Times are seconds
since the person's birth. Cameras are rows of (R 9, t 3, centre 3), measurements ideal image-plane points with `white`, the
(2, 2) matrix that turns their errors into sigmas.
"""

from __future__ import annotations

import math

import numpy as np

from posefuse.files.compiled import kernel

GROUPS = 3  # arms, legs, head: what is exchanged together
FIGURES = 4  # of one view: keypoints measured, gated, sum of squared sigmas, exchanged limbs
_NEVER = -1e9
_FLIP_GAIN = 12.0  # least loss saved by exchanging a limb: noise does not exchange
_FLIP_OBJECTION = 4.0  # least loss added by which a limb says that its own sides are right
_FLIP_MOST = 16.0  # most a keypoint can say about it
_FLIP_MEMORY = 0.05  # weight of the newest view in the share of exchanged ones
_FLIP_STATE = 0.6  # when so many views are exchanged it is the person who is
_BONE_MEMORY = 600.0  # views over which a bone's length is averaged
_BONE_SURE_M = 0.05  # only ends known as well as this teach lengths
_BONE_LEARNT = 30.0  # views before a bone holds
_START_M, _START_M_S = 0.35, 2.0  # of a keypoint seen for the first time, about its neighbour
_REFUSED_MOST = 4.0  # a keypoint that so many views in a row put elsewhere is elsewhere
_DOUBT_M, _DOUBT_M_S = 0.1, 2.0  # as much is then added to what is uncertain about it
# of the changes of a keypoint's model, the share that goes to the more agile one
_AGILER = 0.5
# no keypoint is further from the middle of the body, or faster against it
_REACH_M, _FASTEST_M_S = 1.7, 20.0
_OUT_OF_SIGHT_M = 0.5  # along a ray nobody else crosses
_LIVELY_S = 2.0  # over which what somebody does tells what they may begin to do
_BODY_BORN_M = 0.05  # the newborn body's middle


@kernel()
def state_size(k, m, c, b):
    """Length of a state of k keypoints, m models, c cameras, b bones."""
    return (k + 1) * (m * 91 + 1) + 6 * k * c + k + GROUPS + 2 * b + 1


@kernel()
def parts(state, k, m, c, b):
    """Views into a state.

    x (K + 1, M, 9), its covariance (K + 1, M, 9, 9), the share (K + 1, M) of each model: the body as a whole in the last row,
    the keypoints against it in the others; variance (K + 1,) of their accelerations lately; per camera (K, C): when it last
    measured, the squared px residual, 1/variance; its lasting error (K, C, 3): x, y on the ideal image plane, variance in squared
    sigmas; views refused in a row (K,); share of exchanged views (GROUPS,); bones (B, 2): mean length, views; the time (1,).
    """
    rows = k + 1
    at = rows * m * 9
    x = state[:at].reshape(rows, m, 9)
    cov = state[at : at + rows * m * 81].reshape(rows, m, 9, 9)
    at += rows * m * 81
    share = state[at : at + rows * m].reshape(rows, m)
    at += rows * m
    lively = state[at : at + rows]
    at += rows
    seen = state[at : at + k * c].reshape(k, c)
    at += k * c
    square = state[at : at + k * c].reshape(k, c)
    at += k * c
    precision = state[at : at + k * c].reshape(k, c)
    at += k * c
    lasting = state[at : at + 3 * k * c].reshape(k, c, 3)
    at += 3 * k * c
    refused = state[at : at + k]
    at += k
    flips = state[at : at + GROUPS]
    at += GROUPS
    bones = state[at : at + 2 * b].reshape(b, 2)
    return x, cov, share, lively, seen, square, precision, lasting, refused, flips, bones, state[at + 2 * b :]


@kernel()
def born(state, k, m, c, b, xyz, xyz_cov, velocity_m_s, models):
    """Fill a state at time 0: positions (K, 3) with covariance (K, 3, 3), NaN where not known yet."""
    x, cov, share, _, seen, _, _, _, _, _, _, time = parts(state, k, m, c, b)
    state[:] = 0.0
    seen[:] = _NEVER
    time[0] = 0.0
    middle, count = np.zeros(3), 0
    for i in range(k):
        if math.isfinite(xyz[i, 0]) and math.isfinite(xyz_cov[i, 0, 0]):
            middle += xyz[i]
            count += 1
    middle /= max(count, 1)
    for i in range(k + 1):
        known = i == k or (math.isfinite(xyz[i, 0]) and math.isfinite(xyz_cov[i, 0, 0]))
        for j in range(m):
            share[i, j] = 1.0 / m
            for a in range(3):
                if i == k:
                    x[i, j, a] = middle[a]
                    cov[i, j, a, a] = _BODY_BORN_M**2
                else:
                    x[i, j, a] = xyz[i, a] - middle[a] if known else np.nan
                    for d in range(3):
                        cov[i, j, a, d] = xyz_cov[i, a, d] if known else 0.0
                cov[i, j, 3 + a, 3 + a] = velocity_m_s * velocity_m_s
                cov[i, j, 6 + a, 6 + a] = models[1 if i == k else 0, j, 0] ** 2


@kernel()
def _singer(dt, sigma, lasts, f, q):
    """Transition (3, 3) and process noise (3, 3) of one axis."""
    a = 1.0 / lasts
    u = a * dt
    e, e2 = math.exp(-u), math.exp(-2.0 * u)
    f[:] = 0.0
    f[0, 0] = f[1, 1] = 1.0
    f[0, 1] = dt
    f[2, 2] = e
    if u < 1e-3:
        f[0, 2], f[1, 2] = 0.5 * dt * dt, dt
    else:
        f[0, 2], f[1, 2] = (u - 1.0 + e) / (a * a), (1.0 - e) / a
    v = sigma * sigma
    if u < 0.02:
        # the closed forms cancel to nothing here; these are their leading terms, white jerk
        s = 2.0 * a * v
        q[0, 0], q[0, 1], q[0, 2] = s * dt**5 / 20.0, s * dt**4 / 8.0, s * dt**3 / 6.0
        q[1, 1], q[1, 2], q[2, 2] = s * dt**3 / 3.0, s * dt * dt / 2.0, s * dt
    else:
        q[0, 0] = v / a**4 * (1.0 - e2 + 2.0 * u + 2.0 * u**3 / 3.0 - 2.0 * u * u - 4.0 * u * e)
        q[0, 1] = v / a**3 * (e2 + 1.0 - 2.0 * e + 2.0 * u * e - 2.0 * u + u * u)
        q[0, 2] = v / (a * a) * (1.0 - e2 - 2.0 * u * e)
        q[1, 1] = v / (a * a) * (4.0 * e - 3.0 - e2 + 2.0 * u)
        q[1, 2] = v / a * (e2 + 1.0 - 2.0 * e)
        q[2, 2] = v * (1.0 - e2)
    q[1, 0], q[2, 0], q[2, 1] = q[0, 1], q[0, 2], q[1, 2]


@kernel()
def _goes(i, j, m, stay):
    """Chance to change from model i to j: only to the next calmer or more agile one, more readily to the calmer."""
    up = (1.0 - stay) * _AGILER if i < m - 1 else 0.0
    down = (1.0 - stay) * (1.0 - _AGILER) if i > 0 else 0.0
    if j == i + 1:
        return up
    if j == i - 1:
        return down
    return 1.0 - up - down if i == j else 0.0


@kernel()
def _mix(x, cov, share, stay, mixed_x, mixed_cov, mixed_share):
    """What each model of one keypoint starts the next step from, and its share, when a model is kept with chance `stay`."""
    m = len(share)
    for j in range(m):
        total = 0.0
        for i in range(m):
            total += _goes(i, j, m, stay) * share[i]
        mixed_share[j] = total
        mixed_x[j, :] = 0.0
        mixed_cov[j, :, :] = 0.0
        for i in range(m):
            w = _goes(i, j, m, stay) * share[i] / total
            for a in range(9):
                mixed_x[j, a] += w * x[i, a]
        for i in range(m):
            w = _goes(i, j, m, stay) * share[i] / total
            if w < 1e-9:
                continue
            for a in range(9):
                da = x[i, a] - mixed_x[j, a]
                for d in range(a, 9):
                    mixed_cov[j, a, d] += w * (cov[i, a, d] + da * (x[i, d] - mixed_x[j, d]))
        for a in range(9):
            for d in range(a):
                mixed_cov[j, a, d] = mixed_cov[j, d, a]


@kernel()
def _forward(x, cov, f, q):
    """One model's x (9,) and cov (9, 9) through f, q (3, 3) of every axis, in place."""
    f01, f02, f12, f22 = f[0, 1], f[0, 2], f[1, 2], f[2, 2]
    for a in range(3):
        x[a] += f01 * x[3 + a] + f02 * x[6 + a]
        x[3 + a] += f12 * x[6 + a]
        x[6 + a] *= f22
    for a in range(3):
        for d in range(9):
            cov[a, d] += f01 * cov[3 + a, d] + f02 * cov[6 + a, d]
            cov[3 + a, d] += f12 * cov[6 + a, d]
            cov[6 + a, d] *= f22
    for d in range(9):
        for a in range(3):
            cov[d, a] += f01 * cov[d, 3 + a] + f02 * cov[d, 6 + a]
            cov[d, 3 + a] += f12 * cov[d, 6 + a]
            cov[d, 6 + a] *= f22
    for a in range(3):
        for i in range(3):
            for j in range(3):
                cov[3 * i + a, 3 * j + a] += q[i, j]


@kernel()
def _combined(x, cov, share, mean, spread):
    """Position (3,) and covariance (3, 3) of one keypoint over its models."""
    m = len(share)
    for a in range(3):
        mean[a] = 0.0
        for j in range(m):
            mean[a] += share[j] * x[j, a]
    spread[:] = 0.0
    for j in range(m):
        for a in range(3):
            for d in range(3):
                spread[a, d] += share[j] * (cov[j, a, d] + (x[j, a] - mean[a]) * (x[j, d] - mean[d]))


@kernel()
def _ray(camera, point, h, slope):
    """Ideal image point h (2,) of a world point and its derivative slope (2, 3); False behind the camera."""
    X = camera[0] * point[0] + camera[1] * point[1] + camera[2] * point[2] + camera[9]
    Y = camera[3] * point[0] + camera[4] * point[1] + camera[5] * point[2] + camera[10]
    Z = camera[6] * point[0] + camera[7] * point[1] + camera[8] * point[2] + camera[11]
    if not Z > 0.05:
        return False
    h[0], h[1] = X / Z, Y / Z
    for a in range(3):
        slope[0, a] = (camera[a] - h[0] * camera[6 + a]) / Z
        slope[1, a] = (camera[3 + a] - h[1] * camera[6 + a]) / Z
    return True


@kernel()
def _whitened(white, slope, z, h, rows, error):
    """rows (2, 3) = white slope, error (2,) = white (z - h)."""
    dx, dy = z[0] - h[0], z[1] - h[1]
    for i in range(2):
        error[i] = white[i, 0] * dx + white[i, 1] * dy
        for a in range(3):
            rows[i, a] = white[i, 0] * slope[0, a] + white[i, 1] * slope[1, a]


@kernel()
def _expected(rows, spread, noise):
    """Three entries of the innovation covariance rows spread rows^T + 1."""
    s00, s01, s11 = noise, 0.0, noise
    for a in range(3):
        t0, t1 = 0.0, 0.0
        for d in range(3):
            t0 += spread[a, d] * rows[0, d]
            t1 += spread[a, d] * rows[1, d]
        s00 += rows[0, a] * t0
        s01 += rows[0, a] * t1
        s11 += rows[1, a] * t1
    return s00, s01, s11


@kernel()
def _square(s00, s01, s11, e0, e1):
    return (s11 * e0 * e0 - 2.0 * s01 * e0 * e1 + s00 * e1 * e1) / (s00 * s11 - s01 * s01)


@kernel()
def _shared(share):
    """Shares that sum to 1; none dies out, so that the next change finds it alive."""
    total = share.sum()
    for j in range(len(share)):
        share[j] = max(share[j] / total, 1e-4)
    share /= share.sum()


@kernel()
def _update(x, cov, share, rows, away, noise, common, outlier, gate):
    """One ray into all models of a keypoint; `away` (M, 2) its error from each, `common` (3, 3) what the body adds to it.

    Returns its squared distance from the model that expected it most; nothing is changed beyond `gate`.
    """
    m = len(share)
    nearest = np.inf
    for j in range(m):
        s00, s01, s11 = _expected(rows, cov[j, :3, :3] + common, noise)
        nearest = min(nearest, _square(s00, s01, s11, away[j, 0], away[j, 1]))
    if not nearest <= gate:
        return nearest
    # beyond the knee a view is believed as if it were as noisy as it turned out to be
    extra = max(nearest / outlier, 1.0) - 1.0
    best = np.inf
    for j in range(m):
        s00, s01, s11 = _expected(rows, cov[j, :3, :3] + common, noise)
        best = min(best, _square(s00 + extra, s01, s11 + extra, away[j, 0], away[j, 1]))
    gain = np.empty((9, 2))
    for j in range(m):
        s00, s01, s11 = _expected(rows, cov[j, :3, :3] + common, noise)
        s00 += extra
        s11 += extra
        det = s00 * s11 - s01 * s01
        e0, e1 = away[j, 0], away[j, 1]
        share[j] *= math.exp(0.5 * (best - _square(s00, s01, s11, e0, e1))) / math.sqrt(det)
        for i in range(9):
            t0, t1 = 0.0, 0.0
            for a in range(3):
                t0 += cov[j, i, a] * rows[0, a]
                t1 += cov[j, i, a] * rows[1, a]
            gain[i, 0] = (t0 * s11 - t1 * s01) / det
            gain[i, 1] = (t1 * s00 - t0 * s01) / det
            x[j, i] += gain[i, 0] * e0 + gain[i, 1] * e1
        for i in range(9):
            g0 = gain[i, 0] * s00 + gain[i, 1] * s01
            g1 = gain[i, 0] * s01 + gain[i, 1] * s11
            for a in range(i, 9):
                cov[j, i, a] -= g0 * gain[a, 0] + g1 * gain[a, 1]
                cov[j, a, i] = cov[j, i, a]
    _shared(share)
    return nearest


@kernel()
def _doubt(cov):
    for j in range(len(cov)):
        for a in range(3):
            cov[j, a, a] += _DOUBT_M**2
            cov[j, 3 + a, 3 + a] += _DOUBT_M_S**2


@kernel()
def _move_body(
    camera, c, t, z, white, late, x, cov, share, means, spreads, seen, lasting, mirror, group, exchanged, rules
):  # fmt: skip
    """What all keypoints of one view say together about where the body is: one measurement of its three coordinates.

    Its information and pull are sums over the keypoints, each with what is uncertain about its own place against the body.
    """
    k, m = len(z), x.shape[1]
    info, pull = np.zeros((3, 3)), np.zeros(3)
    h, slope, rows, error, point = np.empty(2), np.empty((2, 3)), np.empty((2, 3)), np.empty(2), np.empty(3)
    for i in range(k):
        o = mirror[i] if group[i] >= 0 and exchanged[group[i]] > 0.0 else i
        if not (math.isfinite(z[o, 0]) and math.isfinite(means[i, 0])):
            continue
        for a in range(3):
            drift = 0.0
            for j in range(m):
                drift += share[k, j] * x[k, j, 3 + a] + share[i, j] * x[i, j, 3 + a]
            point[a] = means[k, a] + means[i, a] + late[o] * drift
        if not _ray(camera, point, h, slope):
            continue
        _whitened(white[o], slope, z[o], h, rows, error)
        keep = math.exp(-(t - seen[i, c]) / rules[5])
        for r in range(2):
            error[r] -= keep * (white[o, r, 0] * lasting[i, c, 0] + white[o, r, 1] * lasting[i, c, 1])
        noise = 1.0 - (rules[4] - lasting[i, c, 2]) * keep * keep
        s00, s01, s11 = _expected(rows, spreads[i] + spreads[k], noise)
        far = _square(s00, s01, s11, error[0], error[1])
        if not far <= rules[1]:
            continue
        s00, s01, s11 = _expected(rows, spreads[i], noise)
        extra = max(far / rules[0], 1.0) - 1.0
        s00, s11 = s00 + extra, s11 + extra
        det = s00 * s11 - s01 * s01
        for a in range(3):
            g0 = (rows[0, a] * s11 - rows[1, a] * s01) / det
            g1 = (rows[1, a] * s00 - rows[0, a] * s01) / det
            pull[a] += g0 * error[0] + g1 * error[1]
            for d in range(3):
                info[a, d] += g0 * rows[0, d] + g1 * rows[1, d]
    _pull(x[k], cov[k], share[k], means[k], info, pull)
    _combined(x[k], cov[k], share[k], means[k], spreads[k])


@kernel()
def _pull(x, cov, share, about, info, pull):
    """A measurement of position by its information (3, 3), and pull (3,) at `about`, into all models of one point."""
    m = len(share)
    mix, inverse, gain, u = np.empty((3, 3)), np.empty((3, 3)), np.empty((9, 3)), np.empty(3)
    likely = np.empty(m)
    for j in range(m):
        for a in range(3):
            u[a] = pull[a]
            for d in range(3):
                u[a] -= info[a, d] * (x[j, d] - about[d])
        for a in range(3):
            for d in range(3):
                mix[a, d] = 1.0 if a == d else 0.0
                for e in range(3):
                    mix[a, d] += info[a, e] * cov[j, e, d]
        det = _inverse3_any(mix, inverse)
        for i in range(9):
            for a in range(3):
                gain[i, a] = 0.0
                for d in range(3):
                    gain[i, a] += cov[j, i, d] * inverse[d, a]
        value = -0.5 * math.log(det)
        for a in range(3):
            away = x[j, a] - about[a]
            value += pull[a] * away
            for d in range(3):
                value += 0.5 * u[a] * gain[a, d] * u[d] - 0.5 * away * info[a, d] * (x[j, d] - about[d])
        likely[j] = value
        top = cov[j, :3].copy()
        for i in range(9):
            for a in range(3):
                x[j, i] += gain[i, a] * u[a]
        for i in range(9):
            for d in range(9):
                for a in range(3):
                    for e in range(3):
                        cov[j, i, d] -= gain[i, a] * info[a, e] * top[e, d]
        for i in range(9):
            for d in range(i):
                cov[j, i, d] = cov[j, d, i] = 0.5 * (cov[j, i, d] + cov[j, d, i])
    best = likely.max()
    for j in range(m):
        share[j] *= math.exp(likely[j] - best)
    _shared(share)


@kernel()
def _inverse3_any(a, out):
    """Inverse of any 3x3 matrix into `out`; its determinant."""
    m00, m01 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1], a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    m02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    det = a[0, 0] * m00 + a[0, 1] * m01 + a[0, 2] * m02
    out[0, 0], out[1, 0], out[2, 0] = m00 / det, m01 / det, m02 / det
    out[0, 1] = (a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]) / det
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) / det
    out[2, 1] = (a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]) / det
    out[0, 2] = (a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]) / det
    out[1, 2] = (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) / det
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) / det
    return det


@kernel()
def _centre_body(x, share):
    """Give the body what its keypoints have in common: whose motion it is would stay open otherwise."""
    k, m = len(x) - 1, x.shape[1]
    mean, count = np.zeros(9), 0
    for i in range(k):
        if math.isfinite(x[i, 0, 0]):
            count += 1
            for j in range(m):
                for a in range(9):
                    mean[a] += share[i, j] * x[i, j, a]
    if count == 0:
        return
    mean /= count
    for j in range(m):
        x[k, j] += mean
        for i in range(k):
            x[i, j] -= mean


@kernel()
def _learn_lasting(lasting, white, s00, s01, s11, error):
    """What of an error is this camera's own and will be there in its next view too."""
    det = s00 * s11 - s01 * s01
    v = lasting[2]
    g0, g1 = v * (s11 * error[0] - s01 * error[1]) / det, v * (s00 * error[1] - s01 * error[0]) / det
    scale = white[0, 0] * white[1, 1] - white[0, 1] * white[1, 0]
    lasting[0] += (white[1, 1] * g0 - white[0, 1] * g1) / scale
    lasting[1] += (white[0, 0] * g1 - white[1, 0] * g0) / scale
    lasting[2] = v - 0.5 * v * v * (s00 + s11) / det


@kernel()
def _flipped_groups(camera, z, white, late, x, means, spreads, mirror, group, out):
    """out (GROUPS,): which limbs fit clearly better with left and right exchanged."""
    gain = np.zeros(GROUPS)
    h, slope, rows, error, point = np.empty(2), np.empty((2, 3)), np.empty((2, 3)), np.empty(2), np.empty(3)
    for i in range(len(z)):
        g, o = group[i], mirror[i]
        if g < 0 or not (math.isfinite(z[i, 0]) and math.isfinite(z[o, 0]) and math.isfinite(means[i, 0])):
            continue
        for turn in range(2):
            k = i if turn == 0 else o
            for a in range(3):
                point[a] = means[i, a]
            if not _ray(camera, point, h, slope):
                continue
            _whitened(white[k], slope, z[k], h, rows, error)
            s00, s01, s11 = _expected(rows, spreads[i], 1.0)
            loss = min(_square(s00, s01, s11, error[0], error[1]), _FLIP_MOST)
            gain[g] += loss if turn == 0 else -loss
    # a body is exchanged as a whole when no limb objects: eyes and ears are too close together to tell by themselves
    whole = gain.sum() > _FLIP_GAIN and gain.min() > -_FLIP_OBJECTION
    for g in range(GROUPS):
        out[g] = whole or gain[g] > _FLIP_GAIN


@kernel()
def _start_missing(x, cov, seen, z, now, lost_after, neighbours, acceleration):
    """Give keypoints that are seen but not tracked a broad start about a tracked neighbour, or about the body."""
    k, m, _ = x.shape
    k -= 1
    middle, count = np.zeros(3), 0
    for i in range(k):
        if math.isfinite(x[i, 0, 0]) and now - seen[i].max() > lost_after and seen[i].max() > _NEVER:
            x[i, :, :3] = np.nan
        if math.isfinite(x[i, 0, 0]):
            middle += x[i, 0, :3]
            count += 1
    if count == 0:
        return
    middle /= count
    for i in range(k):
        if math.isfinite(x[i, 0, 0]) or not math.isfinite(z[i, 0]):
            continue
        about, motion, near = middle.copy(), np.zeros(3), 0
        for o in neighbours[i]:
            if o >= 0 and math.isfinite(x[o, 0, 0]):
                if near == 0:
                    about[:] = 0.0
                about += x[o, 0, :3]
                motion += x[o, 0, 3:6]
                near += 1
        if near > 0:
            about /= near
            motion /= near
        wide = _START_M if near > 0 else 2.0 * _START_M
        for j in range(m):
            cov[i, j, :, :] = 0.0
            for a in range(3):
                x[i, j, a], x[i, j, 3 + a], x[i, j, 6 + a] = about[a], motion[a], 0.0
                cov[i, j, a, a] = wide * wide
                cov[i, j, 3 + a, 3 + a] = _START_M_S * _START_M_S
                cov[i, j, 6 + a, 6 + a] = acceleration[j] * acceleration[j]


@kernel()
def _let_go_of_strays(x, share, means):
    """Keypoints where no body can have them are no longer tracked; their next view starts them anew."""
    known = np.flatnonzero(np.isfinite(means[:, 0]))
    if len(known) < 3:
        return
    middle, motion = np.empty(3), np.empty(3)
    for a in range(3):
        middle[a] = np.median(means[known, a])
        motion[a] = np.median(x[known, 0, 3 + a])
    for i in known:
        away2, fast2 = 0.0, 0.0
        for a in range(3):
            speed = 0.0
            for j in range(x.shape[1]):
                speed += share[i, j] * x[i, j, 3 + a]
            away2 += (means[i, a] - middle[a]) ** 2
            fast2 += (speed - motion[a]) ** 2
        if not (away2 < _REACH_M**2 and fast2 < _FASTEST_M_S**2):
            x[i, :, :] = np.nan
            means[i, :] = np.nan


@kernel()
def _exchange_person(x, cov, share, seen, square, precision, lasting, mirror, group, g):
    """Exchange left and right of one limb of the person."""
    for i in range(len(mirror)):
        o = mirror[i]
        if group[i] == g and i < o:
            kept_x, kept_cov, kept_share = x[i].copy(), cov[i].copy(), share[i].copy()
            x[i], cov[i], share[i] = x[o], cov[o], share[o]
            x[o], cov[o], share[o] = kept_x, kept_cov, kept_share
            for c in range(seen.shape[1]):
                seen[i, c], seen[o, c] = seen[o, c], seen[i, c]
                square[i, c], square[o, c] = square[o, c], square[i, c]
                precision[i, c], precision[o, c] = precision[o, c], precision[i, c]
                for r in range(3):
                    lasting[i, c, r], lasting[o, c, r] = lasting[o, c, r], lasting[i, c, r]


@kernel()
def _learn_bones(bones, ends, means, spreads):
    for b in range(len(ends)):
        i, o = ends[b, 0], ends[b, 1]
        d2, both, along = 0.0, 0.0, 0.0
        for a in range(3):
            d2 += (means[i, a] - means[o, a]) ** 2
            both += spreads[i, a, a] + spreads[o, a, a]
        if not (d2 > 1e-4 and both < 6.0 * _BONE_SURE_M**2):
            continue
        for a in range(3):
            for d in range(3):
                along += (means[i, a] - means[o, a]) * (spreads[i, a, d] + spreads[o, a, d]) * (means[i, d] - means[o, d]) / d2
        length = math.sqrt(d2)
        # noise across a bone makes it look longer
        length -= (both - along) / (2.0 * length)
        bones[b, 1] = min(bones[b, 1] + 1.0, _BONE_MEMORY)
        bones[b, 0] += (length - bones[b, 0]) / bones[b, 1]


@kernel()
def _learn_liveliness(lively, share, models, dt):
    """How strongly the body, and each keypoint against it, accelerates over some seconds: calm for now is not calm for good."""
    memory = 1.0 - math.exp(-dt / _LIVELY_S)
    for i in range(len(lively)):
        now = 0.0
        for j in range(share.shape[1]):
            now += share[i, j] * models[1 if i == len(lively) - 1 else 0, j, 0] ** 2
        lively[i] += memory * (now - lively[i])


@kernel()
def step(
    before, after, t, c, z, white, late, px_scale, cameras, mirror, group, neighbours, ends, sizes, models, rules, figures
):  # fmt: skip
    """One view into a person: state `before` -> `after`, at time t not before it.

    Args:
        c: camera. z (K, 2) ideal points, NaN where unseen; white (K, 2, 2); late (K,) how much after t a row was exposed.
        px_scale: (K,) pixels per sigma. cameras: (C, 15). mirror, group: (K,). neighbours: (K, n), -1 for none.
        ends: (B, 2). sizes: (K, M, C, B). models: (2, M, 2) acceleration of keypoints and of the body, and how long it lasts.
        rules: outlier, gate, switch_s, lost_after_s, lasting_share, lasting_s. figures: (FIGURES,) filled.
    """
    k, m, count, b = sizes
    after[:] = before
    x, cov, share, lively, seen, square, precision, lasting, refused, flips, bones, time = parts(after, k, m, count, b)
    dt = t - time[0]
    time[0] = t
    figures[:] = 0.0
    _start_missing(x, cov, seen, z, t, rules[3], neighbours, models[0, :, 0])
    means, spreads = np.full((k + 1, 3), np.nan), np.empty((k + 1, 3, 3))
    _carried_on(x, cov, share, dt, rules[2], models, means, spreads)
    exchanged = np.zeros(GROUPS)
    wheres, wide = means[:k] + means[k], spreads[:k] + spreads[k]
    _flipped_groups(cameras[c], z, white, late, x, wheres, wide, mirror, group, exchanged)
    _move_body(
        cameras[c], c, t, z, white, late, x, cov, share, means, spreads, seen, lasting, mirror, group, exchanged, rules
    )  # fmt: skip
    _work_in(
        cameras[c], c, t, z, white, late, px_scale, x, cov, share, means, spreads, seen, square, precision, lasting, refused,
        mirror, group, exchanged, rules, figures,
    )  # fmt: skip
    for g in range(GROUPS):
        figures[3] += exchanged[g]
        flips[g] += _FLIP_MEMORY * (exchanged[g] - flips[g])
        if flips[g] > _FLIP_STATE:
            _exchange_person(x, cov, share, seen, square, precision, lasting, mirror, group, g)
            flips[g] = 0.0
    _let_go_of_strays(x[:k], share, means[:k])
    _learn_bones(bones, ends, means, spreads)
    _learn_liveliness(lively, share, models, dt)
    _centre_body(x, share)


@kernel()
def _carried_on(x, cov, share, dt, switch_s, models, means, spreads):
    """Everybody `dt` later, in place, models mixed; fills places (K + 1, 3) and their covariances (K + 1, 3, 3)."""
    k, m = len(x) - 1, x.shape[1]
    stay = math.exp(-dt / switch_s)
    f, q = _all_models(dt, models)
    mixed_x, mixed_cov, mixed_share = np.empty((m, 9)), np.empty((m, 9, 9)), np.empty(m)
    for i in range(k + 1):
        if not math.isfinite(x[i, 0, 0]):
            continue
        if dt > 0.0:
            _mix(x[i], cov[i], share[i], stay, mixed_x, mixed_cov, mixed_share)
            whose = 1 if i == k else 0
            for j in range(m):
                _forward(mixed_x[j], mixed_cov[j], f[whose, j], q[whose, j])
            x[i], cov[i], share[i] = mixed_x, mixed_cov, mixed_share
        _combined(x[i], cov[i], share[i], means[i], spreads[i])


@kernel()
def _work_in(
    camera, c, t, z, white, late, px_scale, x, cov, share, means, spreads, seen, square, precision, lasting, refused, mirror,
    group, exchanged, rules, figures,
):  # fmt: skip
    """Every keypoint's ray into the keypoint itself, once the body has moved; fills figures but for the exchanged limbs."""
    k, m = len(z), x.shape[1]
    body = np.zeros(3)
    for a in range(3):
        for j in range(m):
            body[a] += share[k, j] * x[k, j, 3 + a]
    h, slope, rows, error = np.empty(2), np.empty((2, 3)), np.empty((2, 3)), np.empty(2)
    point, before_m, away = np.empty(3), np.empty(3), np.empty((m, 2))
    for i in range(k):
        o = mirror[i] if group[i] >= 0 and exchanged[group[i]] > 0.0 else i
        if not (math.isfinite(z[o, 0]) and math.isfinite(means[i, 0])):
            continue
        for a in range(3):
            drift = body[a]
            for j in range(m):
                drift += share[i, j] * x[i, j, 3 + a]
            before_m[a] = means[i, a]
            point[a] = means[k, a] + means[i, a] + late[o] * drift
        if not _ray(camera, point, h, slope):
            continue
        _whitened(white[o], slope, z[o], h, rows, error)
        keep = math.exp(-(t - seen[i, c]) / rules[5])
        lasting[i, c, 0] *= keep
        lasting[i, c, 1] *= keep
        lasting[i, c, 2] = rules[4] - (rules[4] - lasting[i, c, 2]) * keep * keep
        for r in range(2):
            error[r] -= white[o, r, 0] * lasting[i, c, 0] + white[o, r, 1] * lasting[i, c, 1]
        noise = 1.0 - rules[4] + lasting[i, c, 2]
        for j in range(m):
            for r in range(2):
                away[j, r] = error[r]
                for a in range(3):
                    away[j, r] -= rows[r, a] * (x[i, j, a] - means[i, a])
        s00, s01, s11 = _expected(rows, spreads[i] + spreads[k], noise)
        figures[0] += 1.0
        figures[2] += min(_square(s00, s01, s11, error[0], error[1]), 4.0 * rules[1])
        nearest = _update(x[i], cov[i], share[i], rows, away, noise, spreads[k], rules[0], rules[1])
        if not nearest <= rules[1]:
            figures[1] += 1.0
            refused[i] += 1.0
            if refused[i] >= _REFUSED_MOST:
                refused[i] = 0.0
                _doubt(cov[i])
            continue
        refused[i] = 0.0
        extra = max(nearest / rules[0], 1.0) - 1.0
        _learn_lasting(lasting[i, c], white[o], s00 + extra, s01, s11 + extra, error)
        seen[i, c] = t
        _combined(x[i], cov[i], share[i], means[i], spreads[i])
        for a in range(3):
            point[a] += means[i, a] - before_m[a]
        if _ray(camera, point, h, slope):
            _whitened(white[o], slope, z[o], h, rows, error)
            square[i, c] = (error[0] ** 2 + error[1] ** 2) * px_scale[o] ** 2
        precision[i, c] = 0.5 * (white[o, 0, 0] ** 2 + white[o, 0, 1] ** 2 + white[o, 1, 0] ** 2 + white[o, 1, 1] ** 2)


@kernel()
def where(state, t, sizes, models, means, sigmas):
    """Positions (K, 3) expected at time t and how sure (K,), standard deviation; NaN where not tracked."""
    k, m, c, b = sizes
    spread = np.empty((3, 3))
    x, cov, share, _, _, _, _, _, _, _, _, time = parts(state, k, m, c, b)
    f, q = _all_models(t - time[0], models)
    body, common = np.empty(3), np.empty((3, 3))
    _position(x[k], cov[k], share[k], f[1], q[1], body, common)
    for i in range(k):
        means[i], sigmas[i] = np.nan, np.nan
        if math.isfinite(x[i, 0, 0]):
            _position(x[i], cov[i], share[i], f[0], q[0], means[i], spread)
            means[i] += body
            spread += common
            sigmas[i] = math.sqrt((spread[0, 0] + spread[1, 1] + spread[2, 2]) / 3.0)


@kernel()
def _all_models(dt, models):
    """f, q (2, M, 3, 3) of `_singer`: of keypoints, and of the body."""
    m = models.shape[1]
    f, q = np.empty((2, m, 3, 3)), np.empty((2, m, 3, 3))
    for whose in range(2):
        for j in range(m):
            _singer(max(dt, 0.0), models[whose, j, 0], models[whose, j, 1], f[whose, j], q[whose, j])
    return f, q


@kernel()
def _position(x, cov, share, f, q, mean, spread):
    """Position (3,) and covariance (3, 3) of one keypoint carried on by f, q."""
    m = len(share)
    p, s = np.empty((m, 3)), np.empty((m, 3, 3))
    for j in range(m):
        for a in range(3):
            p[j, a] = x[j, a] + f[j, 0, 1] * x[j, 3 + a] + f[j, 0, 2] * x[j, 6 + a]
            for d in range(3):
                total = 0.0
                for u in range(3):
                    for v in range(3):
                        total += f[j, 0, u] * cov[j, 3 * u + a, 3 * v + d] * f[j, 0, v]
                s[j, a, d] = total + (q[j, 0, 0] if a == d else 0.0)
    mean[:] = 0.0
    spread[:] = 0.0
    for j in range(m):
        for a in range(3):
            mean[a] += share[j] * p[j, a]
    for j in range(m):
        for a in range(3):
            for d in range(3):
                spread[a, d] += share[j] * (s[j, a, d] + (p[j, a] - mean[a]) * (p[j, d] - mean[d]))


@kernel()
def _inverse3(a, out):
    m00, m01 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2], a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    m02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    det = a[0, 0] * m00 + a[0, 1] * m01 + a[0, 2] * m02
    out[0, 0], out[0, 1], out[0, 2] = m00 / det, m01 / det, m02 / det
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]) / det
    out[1, 2] = (a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]) / det
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]) / det
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]


@kernel()
def _add_lasting(share, mean, seen, precision, oldest, cameras, information, spread):
    """spread += what errors that last from frame to frame make of the views not older than `oldest`."""
    information[:] = 0.0
    for a in range(3):
        information[a, a] = 1.0 / _OUT_OF_SIGHT_M**2
    for c in range(len(seen)):
        if seen[c] < oldest:
            continue
        d2 = 0.0
        for a in range(3):
            d2 += (mean[a] - cameras[c, 12 + a]) ** 2
        w = precision[c] / d2
        for a in range(3):
            for d in range(3):
                across = (1.0 if a == d else 0.0) - (mean[a] - cameras[c, 12 + a]) * (mean[d] - cameras[c, 12 + d]) / d2
                information[a, d] += w * across
    inverse = np.empty((3, 3))
    _inverse3(information, inverse)
    for a in range(3):
        for d in range(3):
            spread[a, d] += share * inverse[a, d]


@kernel()
def _hold_bones(xyz, cov, bones, ends, sigma_m):
    """Every learnt bone once, as a measurement of the distance of its ends (errors of different keypoints independent)."""
    unit, pi, po = np.empty(3), np.empty(3), np.empty(3)
    for b in range(len(ends)):
        i, o = ends[b, 0], ends[b, 1]
        if bones[b, 1] < _BONE_LEARNT or not (math.isfinite(xyz[i, 0]) and math.isfinite(xyz[o, 0])):
            continue
        d2 = 0.0
        for a in range(3):
            unit[a] = xyz[i, a] - xyz[o, a]
            d2 += unit[a] ** 2
        if d2 < 1e-6:
            continue
        length = math.sqrt(d2)
        along, both = 0.0, 0.0
        for a in range(3):
            unit[a] /= length
            both += cov[i, a, a] + cov[o, a, a]
        for a in range(3):
            pi[a], po[a] = 0.0, 0.0
            for d in range(3):
                pi[a] += cov[i, a, d] * unit[d]
                po[a] += cov[o, a, d] * unit[d]
        for a in range(3):
            along += unit[a] * (pi[a] + po[a])
        # the curvature of a distance counts as noise: across a short or uncertain bone it tells little
        curved = (both - along) / (2.0 * length)
        s = along + sigma_m * sigma_m + 2.0 * curved * curved
        pull = (bones[b, 0] + curved - length) / s
        for a in range(3):
            xyz[i, a] += pi[a] * pull
            xyz[o, a] -= po[a] * pull
            for d in range(3):
                cov[i, a, d] -= pi[a] * pi[d] / s
                cov[o, a, d] -= po[a] * po[d] / s


@kernel()
def pose(state, t, cameras, ends, sizes, models, rules, xyz, cov, reproj, n_views, kind):
    """What comes out at time t: positions (K, 3), covariances (K, 3, 3), rms px (K,), views (K,), kind (K,).

    rules: measured_s, lost_after_s, lasting_share, bone_sigma_m, kinds FUSED and PREDICTED.
    """
    k, m, count, b = sizes
    x, p, share, lively, seen, square, precision, _, _, _, bones, time = parts(state, k, m, count, b)
    dt = t - time[0]
    f, q = _all_models(dt, models)
    information, body, common = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    _position(x[k], p[k], share[k], f[1], q[1], body, common)
    for i in range(k):
        xyz[i], cov[i], reproj[i], n_views[i], kind[i] = np.nan, np.nan, np.nan, 0, 0
        newest = seen[i].max()
        if not math.isfinite(x[i, 0, 0]) or t - max(newest, 0.0) > rules[1]:
            continue
        _position(x[i], p[i], share[i], f[0], q[0], xyz[i], cov[i])
        xyz[i] += body
        cov[i] += common
        _add_lasting(rules[2], xyz[i], seen[i], precision[i], newest - rules[0], cameras, information, cov[i])
        total = 0.0
        for c in range(count):
            if t - seen[i, c] <= rules[0]:
                n_views[i] += 1
                total += square[i, c]
        kind[i] = rules[4] if n_views[i] > 0 else rules[5]
        if n_views[i] > 0:
            reproj[i] = math.sqrt(total / n_views[i])
    _hold_bones(xyz, cov, bones, ends, rules[3])
    # since the newest view an acceleration may have begun, as strong as there were lately
    unseen = (0.5 * max(dt, 0.0) ** 2) ** 2
    for i in range(k):
        for a in range(3):
            cov[i, a, a] += unseen * (lively[i] + lively[k])


@kernel()
def agreement(camera, means, sigmas, z, mirror, tolerance_m, support, share):
    """How well the person expected at means (K, 3) explains each of P detections z (P, K, 2): filled (P,), (P,).

    A keypoint supports by 1 less its squared miss at the body's depth over the tolerance (widened by what is uncertain);
    left and right exchanged counts too, whichever is better.
    """
    for p in range(len(z)):
        support[p], share[p] = 0.0, 0.0
        for turn in range(2):
            gain, agree, both = 0.0, 0, 0
            for i in range(len(means)):
                o = mirror[i] if turn == 1 else i
                if not (math.isfinite(means[i, 0]) and math.isfinite(z[p, o, 0])):
                    continue
                depth = camera[6] * means[i, 0] + camera[7] * means[i, 1] + camera[8] * means[i, 2] + camera[11]
                if not depth > 0.05:
                    continue
                both += 1
                mx = camera[0] * means[i, 0] + camera[1] * means[i, 1] + camera[2] * means[i, 2] + camera[9]
                my = camera[3] * means[i, 0] + camera[4] * means[i, 1] + camera[5] * means[i, 2] + camera[10]
                miss2 = (mx - z[p, o, 0] * depth) ** 2 + (my - z[p, o, 1] * depth) ** 2
                reach = tolerance_m + 2.0 * min(sigmas[i], tolerance_m)
                if miss2 < reach * reach:
                    agree += 1
                    gain += 1.0 - miss2 / (reach * reach)
            if gain > support[p]:
                support[p], share[p] = gain, agree / both


@kernel()
def measure(table, corner, spacing, xy, sigma, z, white):
    """Raw px (P, K, 2) with sigma (P, K) to ideal points z and whitening (P, K, 2, 2), through a table of ideal points.

    table: (rows, columns, 2) at px corner + spacing * (column, row), read bilinearly; NaN outside and where the lens has
    no inverse.
    """
    rows, columns, _ = table.shape
    for p in range(len(xy)):
        for i in range(xy.shape[1]):
            z[p, i], white[p, i] = np.nan, 0.0
            u, v = (xy[p, i, 0] - corner[0]) / spacing, (xy[p, i, 1] - corner[1]) / spacing
            if not (u >= 0.0 and v >= 0.0 and u < columns - 1 and v < rows - 1 and sigma[p, i] > 0.0):
                continue
            a, b = int(u), int(v)
            du, dv = u - a, v - b
            t00, t01, t10, t11 = table[b, a], table[b, a + 1], table[b + 1, a], table[b + 1, a + 1]
            x_u = ((t01[0] - t00[0]) * (1.0 - dv) + (t11[0] - t10[0]) * dv) / spacing
            y_u = ((t01[1] - t00[1]) * (1.0 - dv) + (t11[1] - t10[1]) * dv) / spacing
            x_v = ((t10[0] - t00[0]) * (1.0 - du) + (t11[0] - t01[0]) * du) / spacing
            y_v = ((t10[1] - t00[1]) * (1.0 - du) + (t11[1] - t01[1]) * du) / spacing
            det = (x_u * y_v - x_v * y_u) * sigma[p, i]
            if not det > 0.0:
                continue
            for r in range(2):
                z[p, i, r] = (t00[r] * (1.0 - du) + t01[r] * du) * (1.0 - dv) + (t10[r] * (1.0 - du) + t11[r] * du) * dv
            white[p, i, 0, 0], white[p, i, 0, 1] = y_v / det, -x_v / det
            white[p, i, 1, 0], white[p, i, 1, 1] = -y_u / det, x_u / det
