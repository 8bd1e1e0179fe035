"""What an image shows at a person's keypoints: colours of clothes, which distinguish people without their faces, and depth."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from posefuse.core import Detections2D
from posefuse.core.arrays import SIGMA_PER_MAD, Array
from posefuse.core.depth import DepthImage
from posefuse.core.skeleton import SIDES

# keypoints with a lower score do not locate the body
_LEAST_SCORE = 0.3
# pixels that a colour is the median of, at least
_LEAST_PIXELS = 4
# along the length of a limb and between the sides of the trunk: clear of the joints, of skin at ankles, and of the outline
_ALONG = np.linspace(0.2, 0.75, 7)
_ACROSS = np.linspace(0.25, 0.75, 4)
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
    return [{f"{side}_{upper}": float(1 - t), f"{side}_{lower}": float(t)} for side in SIDES for t in _ALONG]


# half a window is about 2 cm at the person, whose keypoints extend over some 1.6 m
_WINDOWS_PER_BODY = 80.0
_LEAST_HALF_PX, _MOST_HALF_PX = 1, 8
# the surface is the nearest that takes a quarter of the window: next to a thin limb the rest is what lies behind it
_NEAR_SHARE = 0.25
# of that surface, from its near edge on
_THICK_M = 0.05
# pixels of a window whose depth must be known, as a share
_LEAST_KNOWN = 0.3
# a keypoint with a lower score is often hidden: the surface is then that of the occluder, often the person's own body
_LEAST_DEPTH_SCORE = 0.5
# no keypoint is further from the middle of its body along the optical axis
_REACH_M = 1.0


def with_depth(detections: Detections2D, depth: DepthImage | None) -> Detections2D:
    """The same people with the depth of the surface at each keypoint; unchanged where there is no depth image.

    What stands in front of a person is not recognised here: fusion and tracking treat such a depth as an outlier. Keypoints that
    the network is not sure of have no depth.

    Args:
        detections: of one frame. depth: of that frame.
    """
    if depth is None:
        return detections
    if not len(detections):
        return replace(detections, depth_m=np.zeros((*detections.score.shape, 2)))
    found = np.stack([_of_person(xy, score, depth) for xy, score in zip(detections.xy_img, detections.score, strict=True)])
    return replace(detections, depth_m=found)


def _of_person(xy_img: Array, score: Array, depth: DepthImage) -> Array:
    """(K, 2) depth and standard deviation of one person's keypoints (K, 2); NaN where unknown."""
    found = np.full((len(xy_img), 2), np.nan)
    somewhere = (score > 0) & np.isfinite(xy_img).all(axis=-1)
    seen = np.flatnonzero(somewhere & (score >= _LEAST_DEPTH_SCORE))
    if not len(seen):
        return found
    extent_px = np.ptp(xy_img[somewhere], axis=0).max()
    half = int(np.clip(round(float(extent_px) / _WINDOWS_PER_BODY), _LEAST_HALF_PX, _MOST_HALF_PX))
    windows_m = _windows(depth, np.rint(xy_img[seen]).astype(np.int64), half)
    surface_m, spread_m = _near_surface(windows_m)
    known = np.flatnonzero(np.isfinite(surface_m))
    if len(known):
        known = known[np.abs(surface_m[known] - np.median(surface_m[known])) <= _REACH_M]
    found[seen[known], 0] = surface_m[known]
    found[seen[known], 1] = np.hypot(depth.noise.sigma_m(surface_m[known]), spread_m[known])
    return found


def _windows(depth: DepthImage, at: Array, half: int) -> Array:
    """(n, W * W) depths in square windows about pixels (n, 2); NaN where unknown or outside the image."""
    height, width = depth.values.shape
    step = np.arange(-half, half + 1)
    column, row = at[:, 0, None, None] + step, at[:, 1, None, None] + step[:, None]
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    raw = depth.values[row.clip(0, height - 1), column.clip(0, width - 1)]
    return np.where(inside & (raw > 0), raw * depth.unit_m, np.nan).reshape(len(at), -1)


def _near_surface(windows_m: Array) -> tuple[Array, Array]:
    """(n,) median depth of the nearest surface in each window (n, W * W), and how much it varies."""
    known = np.isfinite(windows_m).sum(axis=1)
    ordered = np.sort(windows_m, axis=1)  # NaN last
    near = ordered[np.arange(len(ordered)), (known * _NEAR_SHARE).astype(np.int64).clip(max=ordered.shape[1] - 1)]
    surface = np.where(np.abs(windows_m - near[:, None]) <= _THICK_M, windows_m, np.nan)
    usable = known >= _LEAST_KNOWN * windows_m.shape[1]
    middle, spread = np.full(len(windows_m), np.nan), np.full(len(windows_m), np.nan)
    if usable.any():
        middle[usable] = np.nanmedian(surface[usable], axis=1)
        spread[usable] = SIGMA_PER_MAD * np.nanmedian(np.abs(surface[usable] - middle[usable, None]), axis=1)
    return middle, spread
