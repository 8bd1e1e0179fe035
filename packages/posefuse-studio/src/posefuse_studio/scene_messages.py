"""Binary messages to the pages: the length of a head of JSON (u32, little-endian), the head, arrays of f32, and a file.

The head has the kind, JSON values, and in ``arrays`` how many numbers each array has, in their order. Kinds:

- setup: ``content`` has what stays: bones, colours, cameras, floor (see `setup_message`). labels: people's names by id.
- poses: ``t_s``, ``people`` N, ``keypoints`` K, ``ids``, ``rgba`` (alpha 0: the colours of the bones); arrays ``xyz``, (N, K, 3)
  metres, NaN where unknown, and ``shapes``, (N, K, 3, 3): L of each ellipsoid ``{x + L u : |u| <= 1}``, NaN where there is none.
- image: ``t_s``, ``camera``, ``width``, ``height``, ``detections`` D, ``people`` N, ``keypoints`` K, ``rgba``; arrays ``seen``,
  (D, K, 2), and ``fused``, (N, K, 2), pixels of this image; the file is a JPEG, empty where the camera has no image at this time.
- values: ``t_s``; array ``values``, (V, 2): value and standard deviation, in the order of `SessionStatus.plots`.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np

from posefuse.core import Rig, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.palette import LEFT, RIGHT
from posefuse.outputs.drawing import bone_colours, keypoint_colours

# covariances of unmeasured keypoints are large by design; a ball of a metre would only hide the rest
_LARGEST_M = 0.5


def page_message(kind: str, arrays: Mapping[str, Array] = MappingProxyType({}), file: bytes = b"", **values: Any) -> bytes:
    """One message of a kind; see the module."""
    floats = {name: np.ascontiguousarray(one, "<f4") for name, one in arrays.items()}
    head = json.dumps({"kind": kind, "arrays": {name: one.size for name, one in floats.items()}, **values}, allow_nan=False)
    # a page reads arrays where they lie, which must be at a multiple of four
    raw = head.ljust(-(-len(head) // 4) * 4).encode()
    return b"".join([struct.pack("<I", len(raw)), raw, *(one.tobytes() for one in floats.values()), file])


def poses_message(
    t_s: float, person_id: Array, xyz_world: Array, cov_world: Array | None = None, *, rgba: Sequence[Sequence[int]] | None = None
) -> bytes:
    """People of one time step.

    Args:
        person_id: (N,). xyz_world: (N, K, 3) metres. cov_world: (N, K, 3, 3) for ellipsoids of two standard deviations.
        rgba: (N, 4) 0..255; None: the bones' own colours.
    """
    people, keypoints = xyz_world.shape[:2]
    shapes = {} if cov_world is None else {"shapes": ellipsoid_factors(cov_world)}
    about = {"ids": person_id.tolist(), "rgba": np.zeros((people, 4), int).tolist() if rgba is None else rgba}
    return page_message("poses", {"xyz": xyz_world, **shapes}, t_s=t_s, people=people, keypoints=keypoints, **about)


def ellipsoid_factors(cov: Array, sigmas: float = 2.0) -> Array:
    """(..., 3, 3) symmetric L with ``L L = sigmas^2 cov``; NaN for covariances that are unknown or too large to draw."""
    scaled = np.asarray(cov, float) * sigmas**2
    diagonal = np.diagonal(scaled, axis1=-2, axis2=-1)
    good = np.isfinite(scaled).all(axis=(-2, -1)) & (diagonal > 0).all(axis=-1) & (diagonal.max(axis=-1) < _LARGEST_M**2)
    values, vectors = np.linalg.eigh(np.where(good[..., None, None], scaled, np.eye(3)))
    # by rounding, the extent of a flat one may be below zero
    found = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :] @ np.swapaxes(vectors, -1, -2)
    return np.asarray(np.where(good[..., None, None], found, np.nan))


def image_message(
    t_s: float,
    camera: int,
    jpeg: bytes,
    size_wh: tuple[int, int],
    *,
    detected_px: Array | None = None,
    projected_px: Array | None = None,
    rgba: Sequence[Sequence[int]] = (),
) -> bytes:
    """A camera's image and what to draw over it.

    Args:
        camera: its number in the setup. size_wh: of the image. detected_px: (D, K, 2).
        projected_px: (N, K, 2), in the colours `rgba` (N, 4).
    """
    keypoints = next((one.shape[1] for one in (detected_px, projected_px) if one is not None and len(one)), 0)
    seen, fused = (np.zeros((0, keypoints, 2)) if one is None else one for one in (detected_px, projected_px))
    sizes = {"width": size_wh[0], "height": size_wh[1], "detections": len(seen), "people": len(fused), "keypoints": keypoints}
    return page_message("image", {"seen": seen, "fused": fused}, jpeg, t_s=t_s, camera=camera, rgba=rgba, **sizes)


# how far in front of a camera its image is drawn
_FRUSTUM_M = 0.35
_TRAILS = ("left_wrist", "right_wrist", "left_ankle", "right_ankle")


def setup_message(
    rig: Rig | None = None,
    skeleton: Skeleton | None = None,
    *,
    faulty: Sequence[str] = (),
    centre_cov: Mapping[str, Array] | None = None,
) -> bytes:
    """What stays of a scene.

    Args:
        rig: cameras to draw. skeleton: of the poses to come. faulty: cameras drawn in red.
        centre_cov: (3, 3) covariance of camera centres in m^2, by name; drawn as ellipsoids.
    """
    content = {
        "cameras": [_camera(camera, camera.name in faulty, (centre_cov or {}).get(camera.name)) for camera in rig or ()],
        "floor": _floor(rig),
        **(_bones(skeleton) if skeleton is not None else {"bones": [], "bone_rgb": [], "keypoint_rgb": [], "trails": []}),
    }
    return page_message("setup", content=content)


def _bones(skeleton: Skeleton) -> dict[str, Any]:
    return {
        "bones": skeleton.bone_indices.tolist(),
        "bone_rgb": [list(colour) for colour in bone_colours(skeleton)],
        "sides": {"left": LEFT.on_dark, "right": RIGHT.on_dark},
        "keypoint_rgb": [list(colour) for colour in keypoint_colours(skeleton)],
        "trails": [skeleton.index(name) for name in _TRAILS if name in skeleton.keypoints],
    }


def _camera(camera: Any, faulty: bool, cov: Array | None) -> dict[str, Any]:
    width, height = camera.size_wh
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], float)
    rays = np.asarray(camera.rays_world(corners), float)
    # all corners in one plane, as far as the middle of the image
    axis = camera.cam_from_world.matrix()[2]
    places = camera.centre_world + rays * (_FRUSTUM_M / (rays @ axis))[:, None]
    shape = None if cov is None else ellipsoid_factors(np.asarray(cov))
    return {
        "name": camera.name,
        "centre": np.round(camera.centre_world, 4).tolist(),
        "corners": np.round(places, 4).tolist(),
        "faulty": faulty,
        "ellipsoid": None if shape is None or not np.isfinite(shape).all() else shape.ravel().tolist(),
    }


def _floor(rig: Rig | None) -> dict[str, Any]:
    """A square of whole metres under the cameras, and where to look."""
    if rig is None or not len(rig):
        return {"centre": [0.0, 0.0], "half_m": 3.0}
    centres = rig.centres_world()
    low, high = centres.min(axis=0), centres.max(axis=0)
    half = float(np.ceil(np.clip(max(high[:2] - low[:2]) / 2 + 0.5, 1.5, 30.0)))
    return {"centre": np.round((low + high)[:2] / 2, 2).tolist(), "half_m": half}
