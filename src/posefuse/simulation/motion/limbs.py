"""Two-bone limbs: from end points to segment axes, and from joint angles to segment axes. All vectorised over time."""

from __future__ import annotations

import numpy as np

from posefuse.core.arrays import Array
from posefuse.simulation.body import SimulatedBody, rotation_of

# a limb is never asked to be straighter than this, where its plane is lost
_STRAIGHTEST = 1 - 1e-6


def unit_vectors(vector: Array) -> Array:
    """Vectors (..., 3) scaled to length 1."""
    return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True))


def normal_part(vector: Array, along: Array) -> Array:
    """The direction (..., 3) of what vectors have at a right angle to the unit vectors `along`."""
    return unit_vectors(vector - np.sum(vector * along, axis=-1, keepdims=True) * along)


def frame_along(y: Array, towards_z: Array) -> Array:
    """(..., 3, 3) columns X, Y, Z with Y along `y` exactly and Z as near `towards_z` as that allows."""
    y = unit_vectors(y)
    return _frame(y, normal_part(towards_z, y))


def lengths_m(body: SimulatedBody, side: str, limb: str) -> tuple[float, float]:
    """Lengths of the upper and the lower segment of ``leg`` or ``arm``."""
    names = {"leg": ("hip", "knee", "ankle"), "arm": ("shoulder", "elbow", "wrist")}[limb]
    a, b, c = (body.points_rest[f"{side}_{name}"] for name in names)
    return float(np.linalg.norm(b - a)), float(np.linalg.norm(c - b))


def bend_leg(hip: Array, ankle: Array, forward: Array, lengths: tuple[float, float]) -> tuple[Array, Array]:
    """Axes (T, 3, 3) of thigh and shank that put the ankle where it is asked; the knee bends towards `forward`.

    hip, ankle, forward: (T, 3). An ankle out of reach is met along the line to it.
    """
    return _bent(hip, ankle, forward, lengths, knee=True)


def bend_arm(shoulder: Array, wrist: Array, elbow_side: Array, lengths: tuple[float, float]) -> tuple[Array, Array]:
    """Axes (T, 3, 3) of upper arm and of a forearm turned with it (pronation 0); the elbow points towards `elbow_side`."""
    return _bent(shoulder, wrist, elbow_side, lengths, knee=False)


def _bent(start: Array, end: Array, bulge: Array, lengths: tuple[float, float], knee: bool) -> tuple[Array, Array]:
    upper, lower = lengths
    line = end - start
    distance = np.linalg.norm(line, axis=-1)
    along = line / distance[..., None]
    distance = np.clip(distance, abs(upper - lower) * 1.001, (upper + lower) * _STRAIGHTEST)
    aside = normal_part(bulge, along)
    cosine = (upper**2 + distance**2 - lower**2) / (2 * upper * distance)
    sine = np.sqrt(np.maximum(1 - cosine**2, 0.0))
    middle = upper * (cosine[..., None] * along + sine[..., None] * aside)
    y_upper = -middle / upper
    y_lower = unit_vectors(middle - distance[..., None] * along)
    # the knee bulges forward (anterior), the elbow backward; Z = X x Y with X anterior
    z = unit_vectors(np.cross(aside if knee else -aside, -along))
    return _frame(y_upper, z), _frame(y_lower, z)


def _frame(y: Array, z: Array) -> Array:
    return np.stack([np.cross(y, z), y, z], axis=-1)


def elevated_arm(thorax: Array, side: str, flexion: Array, adduction: Array, rotation: Array) -> Array:
    """Upper-arm axes (T, 3, 3) from Cardan ZXY angles in radians against the thorax, mirrored on the left as at the hip."""
    angles = np.stack(np.broadcast_arrays(flexion, adduction, rotation), axis=-1)
    return thorax @ rotation_of(f"{side}_hip", angles)


def forearm_and_hand(
    body: SimulatedBody, side: str, upper_arm: Array, flexion: Array | float, pronation: Array
) -> tuple[Array, Array]:
    """Forearm and hand axes (T, 3, 3): an elbow angle, a pronation, and the wrist as at rest."""
    flexion = np.broadcast_to(flexion, upper_arm.shape[:-2])
    angles = np.stack(np.broadcast_arrays(flexion, 0.0, pronation), axis=-1)
    forearm = upper_arm @ rotation_of(f"{side}_elbow", angles)
    return forearm, forearm @ body.rest_rotation(f"{side}_forearm", f"{side}_hand")
