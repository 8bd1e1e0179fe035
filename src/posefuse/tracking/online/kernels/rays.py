"""One keypoint in one view: a ray, two rows, in units of its noise; and limbs with left and right swapped."""

from __future__ import annotations

import math

import numpy as np

from posefuse.foundation.compiled import kernel

from .state import GROUPS


@kernel()
def ray(camera, point, white, z, rows, error):
    """Error (2,) of an ideal point z from a world point and its slope rows (2, 3), in units of noise; False behind the camera."""
    X = camera[0] * point[0] + camera[1] * point[1] + camera[2] * point[2] + camera[3]
    Y = camera[4] * point[0] + camera[5] * point[1] + camera[6] * point[2] + camera[7]
    Z = camera[8] * point[0] + camera[9] * point[1] + camera[10] * point[2] + camera[11]
    if not Z > 0.05:
        return False
    x, y = X / Z, Y / Z
    for i in range(2):
        error[i] = white[i, 0] * (z[0] - x) + white[i, 1] * (z[1] - y)
    for a in range(3):
        along_x, along_y = (camera[a] - x * camera[8 + a]) / Z, (camera[4 + a] - y * camera[8 + a]) / Z
        for i in range(2):
            rows[i, a] = white[i, 0] * along_x + white[i, 1] * along_y
    return True


@kernel()
def expected(rows, spread, noise):
    """Three entries of the innovation covariance rows spread rows^T + noise."""
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
def depth_row(camera, point, measured, row):
    """One measured depth (2,), m and its sigma, as a row (3,) in units of its noise; returns its error from a world point."""
    z, certain = camera[11], 1.0 / measured[1]
    for a in range(3):
        z += camera[8 + a] * point[a]
        row[a] = camera[8 + a] * certain
    return (measured[0] - z) * certain


@kernel()
def squared(s00, s01, s11, e0, e1):
    """e^T S^-1 e of two rows."""
    return (s11 * e0 * e0 - 2.0 * s01 * e0 * e1 + s00 * e1 * e1) / (s00 * s11 - s01 * s01)


@kernel()
def person_agreement(camera, means, sigmas, z, mirror, tolerance_m, support, share):
    """How well the person expected at means (K, 3) explains each of P detections z (P, K, 2): filled (P,), (P,).

    A keypoint supports by 1 less its squared miss at the body's depth over the tolerance (widened by what is uncertain);
    left and right swapped counts too, whichever is better.
    """
    for p in range(len(z)):
        support[p], share[p] = 0.0, 0.0
        for turn in range(2):
            gain, agree, both = 0.0, 0, 0
            for i in range(len(means)):
                o = mirror[i] if turn == 1 else i
                if not (math.isfinite(means[i, 0]) and math.isfinite(z[p, o, 0])):
                    continue
                depth = camera[8] * means[i, 0] + camera[9] * means[i, 1] + camera[10] * means[i, 2] + camera[11]
                if not depth > 0.05:
                    continue
                both += 1
                mx = camera[0] * means[i, 0] + camera[1] * means[i, 1] + camera[2] * means[i, 2] + camera[3]
                my = camera[4] * means[i, 0] + camera[5] * means[i, 1] + camera[6] * means[i, 2] + camera[7]
                miss2 = (mx - z[p, o, 0] * depth) ** 2 + (my - z[p, o, 1] * depth) ** 2
                reach = tolerance_m + 2.0 * min(sigmas[i], tolerance_m)
                if miss2 < reach * reach:
                    agree += 1
                    gain += 1.0 - miss2 / (reach * reach)
            if gain > support[p]:
                support[p], share[p] = gain, agree / both


_SWAP_OBJECTION = 4.0  # least additional loss for which a limb supports its own sides
_SWAP_GAIN = 12.0  # least loss saved by swapping a limb: noise does not swap
_SWAP_MOST = 16.0  # largest contribution of a keypoint


@kernel()
def swapped_groups(view, means, spreads, session, out):
    """out (GROUPS,): which limbs fit clearly better with left and right swapped."""
    z, white, camera = view.z, view.white, session.cameras[view.camera]
    gain = np.zeros(GROUPS)
    rows, error, point = np.empty((2, 3)), np.empty(2), np.empty(3)
    for i in range(len(z)):
        g, o = session.group[i], session.mirror[i]
        if g < 0 or not (math.isfinite(z[i, 0]) and math.isfinite(z[o, 0]) and math.isfinite(means[i, 0])):
            continue
        for turn in range(2):
            k = i if turn == 0 else o
            for a in range(3):
                point[a] = means[i, a]
            if not ray(camera, point, white[k], z[k], rows, error):
                continue
            s00, s01, s11 = expected(rows, spreads[i], 1.0)
            loss = min(squared(s00, s01, s11, error[0], error[1]), _SWAP_MOST)
            gain[g] += loss if turn == 0 else -loss
    # the whole body is swapped when no limb contradicts: eyes and ears alone are too close together to decide. Without it NEES of
    # seven rendered people is 4.05, not 3.80
    whole = gain.sum() > _SWAP_GAIN and gain.min() > -_SWAP_OBJECTION
    for g in range(GROUPS):
        out[g] = whole or gain[g] > _SWAP_GAIN


@kernel()
def swap_person(person, session, g):
    """Swap left and right of one limb of the person."""
    x, cov, share = person.x, person.cov, person.share
    for i in range(len(session.mirror)):
        o = session.mirror[i]
        if session.group[i] == g and i < o:
            kept_x, kept_cov, kept_share = x[i].copy(), cov[i].copy(), share[i].copy()
            x[i], cov[i], share[i] = x[o], cov[o], share[o]
            x[o], cov[o], share[o] = kept_x, kept_cov, kept_share
            person.lively[i], person.lively[o] = person.lively[o], person.lively[i]
            for of_camera in (person.seen, person.square, person.precision, person.deepness):
                for c in range(of_camera.shape[1]):
                    of_camera[i, c], of_camera[o, c] = of_camera[o, c], of_camera[i, c]
