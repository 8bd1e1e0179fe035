"""From images to what networks take: rectangles cut out by affine maps, letterboxes, colours to numbers.

All maps are between pixel centres at integers, as the makers of the networks define them.
"""

from __future__ import annotations

import cv2
import numpy as np

from posefuse.core import Region
from posefuse.core.arrays import Array

from .card import NetworkInput


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
    """(1, 3, H, W) float32 of an RGB crop (H, W, 3) uint8, in the network's channel order and range."""
    ordered = crop if takes.channels == "rgb" else crop[..., ::-1]
    factor = (1 / np.array(takes.std)).astype(np.float32)
    shift = (np.array(takes.mean) / np.array(takes.std)).astype(np.float32)
    return np.ascontiguousarray((ordered * factor - shift).transpose(2, 0, 1)[None])
