"""Motions on which the live tracker is measured and fitted: swinging arms, buckling knees, jumps.

A `Place` gives the ANATOMICAL23 keypoints (T, 23, 3) of one person at times (T,) in seconds. Each function takes a person and
gives the same person doing something else; segments keep their lengths.
"""

from collections.abc import Callable

import numpy as np

from posefuse.core.skeleton import ANATOMICAL23

Place = Callable[[np.ndarray], np.ndarray]
_FEET = ("ankle", "heel", "big_toe", "small_toe")
# knees are never quite straight: from there they would have to bend infinitely fast
_BENT_M = 0.03


def swinging(place: Place, degrees: float = 60.0, rate_hz: float = 0.9) -> Place:
    """The same person, both arms swinging to and fro by so many degrees each way."""
    arms = [[ANATOMICAL23.index(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist")] for side in ("left", "right")]

    def swung(t_s: np.ndarray) -> np.ndarray:
        xyz = place(t_s)
        across = xyz[:, arms[0][0]] - xyz[:, arms[1][0]]
        axis = across / np.linalg.norm(across, axis=-1, keepdims=True)
        for sign, (shoulder, *rest) in zip((1, -1), arms, strict=True):
            angle = sign * np.deg2rad(degrees) * np.sin(2 * np.pi * rate_hz * t_s)
            xyz[:, rest] = xyz[:, [shoulder]] + turned(xyz[:, rest] - xyz[:, [shoulder]], axis[:, None], angle[:, None, None])
        return xyz

    return swung


def turned(vector: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Rodrigues' rotation of vectors (..., 3) about unit axes."""
    along = (vector * axis).sum(axis=-1, keepdims=True) * axis
    beside = np.cross(np.broadcast_to(axis, vector.shape), vector)
    return vector * np.cos(angle) + beside * np.sin(angle) + along * (1 - np.cos(angle))


def crouching(place: Place, depth_m: Callable[[np.ndarray], np.ndarray]) -> Place:
    """The same person, hips and all above them lower by `depth_m` (T,) at times (T,), knees bent over feet that stay."""
    legs = [f"{side}_{part}" for side in ("left", "right") for part in ("knee", *_FEET)]
    upper = [k for k, name in enumerate(ANATOMICAL23.keypoints) if name not in legs]

    def crouched(t_s: np.ndarray) -> np.ndarray:
        xyz = place(t_s)
        standing = xyz.copy()
        xyz[:, upper, 2] -= (_BENT_M + depth_m(t_s))[:, None]
        for side in ("left", "right"):
            hip, knee, ankle, heel, toe = (ANATOMICAL23.index(f"{side}_{p}") for p in ("hip", "knee", "ankle", "heel", "big_toe"))
            thigh_m, shank_m = (np.linalg.norm(standing[:, knee] - standing[:, end], axis=-1) for end in (hip, ankle))
            xyz[:, knee] = bent(xyz[:, hip], xyz[:, ankle], thigh_m, shank_m, standing[:, toe] - standing[:, heel])
        return xyz

    return crouched


def bent(hip: np.ndarray, ankle: np.ndarray, thigh_m: np.ndarray, shank_m: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Where the knee (T, 3) is between hip and ankle: thigh and shank (T,) as long as they are, bent towards `ahead` (T, 3)."""
    line = ankle - hip
    far = np.linalg.norm(line, axis=-1)
    line = line / far[:, None]
    along = (thigh_m**2 - shank_m**2 + far**2) / (2 * far)
    aside = np.sqrt(np.maximum(thigh_m**2 - along**2, 0.0))
    ahead = ahead - (ahead * line).sum(axis=-1, keepdims=True) * line
    ahead = ahead / np.linalg.norm(ahead, axis=-1, keepdims=True)
    return hip + along[:, None] * line + aside[:, None] * ahead


def jumping(place: Place, flight_s: float = 0.5, ground_s: float = 0.6) -> Place:
    """The same person, jumping: flights of gravity alone, and between them knees that give way."""
    gravity = 9.81
    leap = gravity * flight_s / 2

    def depth_m(t_s: np.ndarray) -> np.ndarray:
        u = np.maximum(np.mod(t_s, flight_s + ground_s) - flight_s, 0.0)
        return leap * u - leap / ground_s * u**2

    crouched = crouching(place, depth_m)

    def jumped(t_s: np.ndarray) -> np.ndarray:
        flight = np.mod(t_s, flight_s + ground_s)
        up = np.where(flight < flight_s, leap * flight - gravity * flight**2 / 2, 0.0)
        xyz = crouched(t_s)
        xyz[..., 2] += up[:, None]
        return xyz

    return jumped
