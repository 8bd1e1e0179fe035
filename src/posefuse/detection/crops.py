"""Regions of an image that hold one person, and what networks see through them: squares, rectangles, letterboxes, numbers.

A region comes from the person detector, from keypoints of the previous frame, or from the fused 3D pose projected into the
view, so a camera whose detector sees no person still contributes. All maps are between pixel centres at integers.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any, overload

import cv2
import numpy as np

from posefuse.core import Camera, Frame, Region, ShapeError, Skeleton
from posefuse.core.arrays import Array

from .card import NetworkInput

# side of the region = 2 * this * farthest keypoint from the middle of the hips
REACH = 1.15
_LEAST_KEYPOINTS = 4
_LEAST_RADIUS_PX = 8.0
_UP_STEP_M = 0.1
_FINEST = 3
# what interpolation reads next to a region
_MARGIN_PX = 3.0
_rooms = threading.local()


def check_regions(frames: Sequence[Frame], regions: Sequence[Sequence[Region] | None]) -> None:
    """Raise ShapeError where a detector is not given regions (or None) for each of its frames."""
    if len(frames) != len(regions):
        raise ShapeError(f"detect: expected regions for each of {len(frames)} frames, got {len(regions)}")


def nearest_to(region: Region, middles: Array, most: float) -> int | None:
    """Which of points (n, 2) is nearest to the middle of a region; None where all are farther than this share of its side."""
    away = np.linalg.norm(middles.reshape(-1, 2) - region.centre_img, axis=-1) / region.side_px
    return int(away.argmin()) if away.min(initial=np.inf) < most else None


def region_from_keypoints(xy_img: Any, skeleton: Skeleton, up_img: Any = None) -> Region | None:
    """Region about a person's keypoints (K, 2), upright by the spine.

    Args:
        xy_img: raw px; NaN where missing.
        skeleton: names axis K; needs hips and shoulders.
        up_img: (2,) direction of up in the image for when the spine is not seen; None: the image's own.

    Returns:
        Region: None when fewer than four keypoints are known.
    """
    xy = np.asarray(xy_img, np.float64)
    known = np.asarray(np.isfinite(xy).all(-1))
    if known.sum() < _LEAST_KEYPOINTS:
        return None
    hips = _middle(xy, known, skeleton, ("left_hip", "right_hip"))
    shoulders = _middle(xy, known, skeleton, ("left_shoulder", "right_shoulder"))
    seen = xy[known]
    centre = (seen.min(0) + seen.max(0)) / 2 if hips is None else hips
    up = None if hips is None or shoulders is None else shoulders - hips
    if up is None or not up.any():
        up = np.array([0.0, -1.0]) if up_img is None else np.asarray(up_img, np.float64)
    radius = max(float(np.linalg.norm(seen - centre, axis=-1).max()), _LEAST_RADIUS_PX)
    return Region(centre_img=centre, side_px=2 * REACH * radius, angle_rad=float(np.arctan2(up[0], -up[1])))


def region_from_pose(camera: Camera, xyz_world: Any, skeleton: Skeleton) -> Region | None:
    """Region in which a camera sees a 3D pose (K, 3) in world metres; NaN where missing.

    Upright by the spine, or by gravity where the spine is unknown.

    Returns:
        Region: None when the person is behind the camera, out of the image, or hardly known.
    """
    xyz = np.asarray(xyz_world, np.float64)
    known = np.isfinite(xyz).all(-1)
    if not known.any():
        return None
    foot = xyz[known].mean(0)
    xy = camera.project(np.vstack([xyz, foot, foot + [0.0, 0.0, _UP_STEP_M]]))
    up = xy[-1] - xy[-2]
    region = region_from_keypoints(xy[:-2], skeleton, up if np.isfinite(up).all() and up.any() else None)
    if region is None:
        return None
    half = region.side_px / 2
    inside = (region.centre_img > -half) & (region.centre_img < np.array(camera.size_wh) + half)
    return region if inside.all() else None


def up_angle_rad(camera: Camera) -> float:
    """How far the world's up is turned from the image's up (-y) in the image's middle, clockwise as seen on screen.

    0 for a camera that looks straight up or down, where the image has no up.
    """
    axis_world = camera.cam_from_world.inverse().matrix() @ np.array([0.0, 0.0, 1.0])
    up_cam = camera.cam_from_world.matrix() @ (np.array([0.0, 0.0, 1.0]) - axis_world[2] * axis_world)
    return float(np.arctan2(up_cam[0], -up_cam[1])) if np.hypot(up_cam[0], up_cam[1]) > _UP_STEP_M else 0.0


def _middle(xy: Array, known: Array, skeleton: Skeleton, names: tuple[str, str]) -> Array | None:
    """(2,) middle of two keypoints, or the one that is known, or None."""
    there = [xy[i] for i in map(skeleton.index, names) if known[i]]
    return sum(there[1:], there[0]) / len(there) if there else None


def crop_from_img(region: Region, side_px: int) -> Array:
    """(2, 3) affine map from raw px to px of an upright square crop of `side_px`; pixel centres at integers in both."""
    scale = side_px / region.side_px
    cosine, sine = np.cos(region.angle_rad), np.sin(region.angle_rad)
    turn = scale * np.array([[cosine, sine], [-sine, cosine]])
    return np.hstack([turn, ((side_px - 1) / 2 - turn @ region.centre_img)[:, None]])


def img_from_crop(region: Region, side_px: int, xy_crop: Any) -> Array:
    """Raw px (..., 2) of crop px (..., 2)."""
    return img_from_input(crop_from_img(region, side_px), xy_crop)


def img_from_input(input_from_img: Array, xy: Any) -> Array:
    """Raw px (..., 2) of px (..., 2) of an input, which an affine map (2, 3) takes from raw px."""
    return np.asarray((np.asarray(xy, np.float64) - input_from_img[:, 2]) @ np.linalg.inv(input_from_img[:, :2]).T)


def overlap(box: Array, others: Array) -> Array:
    """(n,) intersection over union of a box (4,) with others (n, 4): left, top, right, bottom."""
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    shared = np.clip(high - low, 0, None).prod(-1)
    area = np.clip(box[2:] - box[:2], 0, None).prod() + np.clip(others[:, 2:] - others[:, :2], 0, None).prod(-1)
    return np.asarray(shared / np.maximum(area - shared, 1e-9))


def overlapping_groups(boxes: Array, most: float) -> list[Array]:
    """Numbers of boxes (B, 4), best first, in groups: the best that is left, and all that overlap it by more than `most`."""
    left = np.arange(len(boxes))
    groups = []
    while len(left):
        same = overlap(boxes[left[0]], boxes[left]) > most
        same[0] = True
        groups.append(left[same])
        left = left[~same]
    return groups


def square_crop(image: Array, region: Region, side_px: int) -> Array:
    """The upright crop (side_px, side_px, 3) uint8; black outside the image.

    A large region is sampled more finely and then averaged, so that fine texture does not alias into the crop.
    """
    finer = int(np.clip(round(region.side_px / side_px / 2), 1, _FINEST))
    affine = crop_from_img(region, side_px * finer)
    # OpenCV samples four channels in half the time that three take, with the same values
    sampled = cv2.warpAffine(_four_channels(image, region), affine, (side_px * finer, side_px * finer), flags=cv2.INTER_LINEAR)
    if finer > 1:
        sampled = cv2.resize(sampled, (side_px, side_px), interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(sampled, cv2.COLOR_RGBA2RGB)


class Crops(Sequence[Array]):
    """Crops of several images (`square_crop`), each made when first asked for: a network can work on the first meanwhile."""

    def __init__(self, regions: Sequence[tuple[Array, Region]], side_px: int) -> None:
        self._regions, self._side_px = regions, side_px
        self._made: dict[int, Array] = {}

    def __len__(self) -> int:
        return len(self._regions)

    @overload
    def __getitem__(self, i: int) -> Array: ...
    @overload
    def __getitem__(self, i: slice) -> Sequence[Array]: ...
    def __getitem__(self, i: int | slice) -> Array | Sequence[Array]:
        if isinstance(i, slice):
            return [self[k] for k in range(len(self))[i]]
        if i not in self._made:
            self._made[i] = square_crop(*self._regions[i], self._side_px)
        return self._made[i]


def _four_channels(image: Array, region: Region) -> Array:
    """(H, W, 4) the image; valid in and next to the region only, and until the thread's next call."""
    held = getattr(_rooms, "held", None)
    if held is None or held.shape[:2] != image.shape[:2]:
        held = _rooms.held = np.empty((*image.shape[:2], 4), np.uint8)
    reach = region.side_px * (abs(np.cos(region.angle_rad)) + abs(np.sin(region.angle_rad))) / 2 + _MARGIN_PX
    left, top = (int(max(centre - reach, 0)) for centre in region.centre_img)
    right, bottom = (int(max(centre + reach, 0)) + 1 for centre in region.centre_img)
    part = image[top:bottom, left:right]
    if part.size:
        cv2.cvtColor(part, cv2.COLOR_RGB2RGBA, dst=held[top:bottom, left:right])
    return held


def input_crop_from_img(region: Region, size_wh: tuple[int, int], udp: bool = False) -> Array:
    """(2, 3) affine map from raw px to px of an upright crop as high as the region, of the input's own proportions.

    Args:
        region: the person; its side is the height of the crop, padding included.
        size_wh: px of the crop.
        udp: the crop's first and last pixel centres lie on the rectangle's rim; otherwise its corners do.
    """
    width, height = size_wh
    spans = np.array([width - 1, height - 1] if udp else [width, height], np.float64)
    # one scale for both axes, as without udp: the rectangle's proportions are the input's
    scale = spans / (region.side_px * np.array([width / height, 1.0]))
    cosine, sine = np.cos(region.angle_rad), np.sin(region.angle_rad)
    turn = scale[:, None] * np.array([[cosine, sine], [-sine, cosine]])
    return np.hstack([turn, (spans / 2 - turn @ region.centre_img)[:, None]])


def region_of_box(box_img: Array, size_wh: tuple[int, int], padding: float, angle_rad: float = 0.0) -> Region:
    """The region whose crop of these proportions just holds a padded box (left, top, right, bottom)."""
    corners = np.asarray(box_img, np.float64).reshape(2, 2)
    width, height = np.maximum(corners[1] - corners[0], 1.0)
    side = padding * max(height, width * size_wh[1] / size_wh[0])
    return Region(centre_img=corners.mean(axis=0), side_px=float(side), angle_rad=angle_rad)


def letterbox_from_img(size_wh: tuple[int, int], takes: NetworkInput, up_rad: float = 0.0) -> Array:
    """(2, 3) affine map from raw px to px of the input: the whole image, turned so that `up_rad` is up, as large as fits.

    Args:
        size_wh: px of the image. takes: the network's input.
        up_rad: direction of up in the image, clockwise from the image's own.
    """
    cosine, sine = np.cos(up_rad), np.sin(up_rad)
    turn = np.array([[cosine, sine], [-sine, cosine]])
    corners = np.array([[0, 0], [size_wh[0], 0], [0, size_wh[1]], size_wh], np.float64) @ turn.T
    low, spans = corners.min(axis=0), np.ptp(corners, axis=0)
    ratio = float((np.array(takes.size_wh) / spans).min())
    room = np.array(takes.size_wh) - np.rint(spans * ratio)
    corner = np.rint(room / 2 - 0.1) if takes.letterbox == "centre" else np.zeros(2)
    return np.hstack([ratio * turn, (corner - ratio * low)[:, None]])


def warp_to_input(image: Array, input_from_img: Array, takes: NetworkInput, fill: int = 0) -> Array:
    """The input (H, W, 3) uint8 as the affine map shows it; `fill` outside the image."""
    return np.asarray(
        cv2.warpAffine(image, input_from_img, takes.size_wh, flags=cv2.INTER_LINEAR, borderValue=(fill, fill, fill))
    )


def normalised(crop: Array, takes: NetworkInput) -> Array:
    """(1, 3, H, W) float32 of an RGB crop (H, W, 3) uint8, in the network's channel order and range; one pass of OpenCV."""
    factors = tuple(1 / value for value in takes.std)
    taken = cv2.dnn.Image2BlobParams(factors, crop.shape[1::-1], takes.mean, takes.channels == "bgr")
    return np.asarray(cv2.dnn.blobFromImageWithParams(crop, taken))
