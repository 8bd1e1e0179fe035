"""Colours of people's clothes: a cue that distinguishes them without their faces."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from posefuse.core import Detections2D
from posefuse.core.arrays import Array

# keypoints with a lower score do not locate the body
_LEAST_SCORE = 0.3
# pixels that a colour is the median of, at least
_LEAST_PIXELS = 4
# along the length of a limb and between the sides of the trunk: clear of the joints, of skin at ankles, and of the outline
_ALONG = np.linspace(0.2, 0.75, 7)
_ACROSS = np.linspace(0.25, 0.75, 4)
_SIDES = ("left", "right")
# from linear sRGB to CIE XYZ of white point D65 (IEC 61966-2-1), in shares of the white point
_XYZ_FROM_RGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_XYZ_FROM_RGB = _XYZ_FROM_RGB / _XYZ_FROM_RGB.sum(axis=1, keepdims=True)


def with_clothing(detections: Detections2D, image: Array) -> Detections2D:
    """The same people with the colours of their clothes: medians over some 20 pixels of trunk, thighs and shanks.

    Args:
        detections: of one frame. image: (H, W, 3) uint8 RGB of that frame, as the camera gave it.
    """
    if not len(detections):
        return detections
    return replace(detections, clothing_lab=_colours(detections, image))


def lab_from_srgb(rgb: Array) -> Array:
    """CIE L*a*b* (..., 3), white point D65, of sRGB colours (..., 3) from 0 to 255."""
    share = np.asarray(rgb, np.float64) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    xyz = linear @ _XYZ_FROM_RGB.T
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def _colours(detections: Detections2D, image: Array) -> Array:
    weights, begin = _samples(detections.skeleton.keypoints)
    found = np.full((len(detections), len(begin) - 1, 3), np.nan)
    usable = (detections.score >= _LEAST_SCORE) & np.isfinite(detections.xy_img).all(axis=-1)
    xy = np.where(usable[..., None], detections.xy_img, 0.0)
    at = np.rint(np.einsum("sk,pkc->psc", weights, xy)).astype(np.int64)
    inside = (at >= 0).all(axis=-1) & (at < (image.shape[1], image.shape[0])).all(axis=-1)
    # every keypoint that a sample is made from
    inside &= ~((weights != 0) @ ~usable.T).T
    for part in range(len(begin) - 1):
        mine = slice(begin[part], begin[part + 1])
        for person in np.flatnonzero(inside[:, mine].sum(axis=1) >= _LEAST_PIXELS):
            x, y = at[person, mine][inside[person, mine]].T
            found[person, part] = median_colour(image[y, x])
    return lab_from_srgb(found)


def median_colour(rgb: Array) -> Array:
    """(3,) median of colours (S, 3): that of numpy, which takes six times as long for so few."""
    ordered, count = np.sort(rgb, axis=0).astype(np.float64), len(rgb)
    return np.asarray((ordered[(count - 1) // 2] + ordered[count // 2]) / 2)


@lru_cache
def _samples(keypoints: tuple[str, ...]) -> tuple[Array, Array]:
    """(S, K) pixels as weighted means of keypoints, and (4,) where trunk, thighs and shanks begin and end; none where the
    skeleton lacks a keypoint."""
    parts = [_trunk(), _limbs("hip", "knee"), _limbs("knee", "ankle")]
    rows: list[Array] = []
    begin = [0]
    for samples in parts:
        for sample in samples:
            if set(sample) <= set(keypoints):
                rows.append(np.array([sample.get(name, 0.0) for name in keypoints]))
        begin.append(len(rows))
    return np.array(rows).reshape(len(rows), len(keypoints)), np.array(begin)


def _trunk() -> list[dict[str, float]]:
    return [
        {
            f"{side}_{end}": float(across * along)
            for side, across in (("left", 1 - u), ("right", u))
            for end, along in (("shoulder", 1 - v), ("hip", v))
        }
        for u in _ACROSS
        for v in _ALONG
    ]


def _limbs(upper: str, lower: str) -> list[dict[str, float]]:
    return [{f"{side}_{upper}": float(1 - t), f"{side}_{lower}": float(t)} for side in _SIDES for t in _ALONG]
