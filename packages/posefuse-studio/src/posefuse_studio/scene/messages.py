"""Binary messages to the pages. Little-endian; every message begins with a header of 16 bytes.

====== ====== ========================================================================================================
offset type   header
====== ====== ========================================================================================================
0      2 x u8 ``PF``
2      u8     version, 1
3      u8     kind: 1 setup, 2 poses, 3 image, 4 values, 5 labels
4      u32    reserved, 0
8      f64    time in seconds that the message is for
====== ====== ========================================================================================================

After the header:

- setup (1) and labels (5): JSON, UTF-8. Setup has the constants: bones, colours, cameras, floor (see `setup_message`); labels
  give people's names by id.
- poses (2): u16 people N, u16 keypoints K, u32 flags (1: ellipsoids follow); per person u32 id and 4 x u8 rgba (alpha 0: the
  colours of the bones); N*K*3 x f32 world coordinates in metres, NaN where unknown; with flag 1 N*K*9 x f32: row-major L of
  each ellipsoid ``{x + L u : |u| <= 1}``, NaN where there is none.
- image (3): u16 camera, width, height, detections D, people N, keypoints K, u32 reserved; per person 4 x u8 rgba; D*K*2 x f32
  detected and N*K*2 x f32 projected keypoints in pixels of this image; the rest is a JPEG file, empty where the camera has no
  image at this time.
- values (4): u32 count V; V*2 x f32: value and standard deviation, in the order of the setup's plots.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from posefuse.core.arrays import Array

VERSION = 1
SETUP, POSES, IMAGE, VALUES, LABELS = 1, 2, 3, 4, 5
HEADER = struct.Struct("<2sBBId")
_ELLIPSOIDS = 1
# covariances of unmeasured keypoints are large by design; a ball of a metre would only hide the rest
_LARGEST_M = 0.5


def packed_header(kind: int, t_s: float) -> bytes:
    """The first 16 bytes."""
    return HEADER.pack(b"PF", VERSION, kind, 0, t_s)


def setup_message(setup: Mapping[str, Any]) -> bytes:
    """What stays: see `setup.scene_setup`."""
    return packed_header(SETUP, 0.0) + json.dumps(setup, allow_nan=False).encode()


def labels_message(names: Mapping[int, str]) -> bytes:
    """People's names by id."""
    return packed_header(LABELS, 0.0) + json.dumps({str(person): name for person, name in names.items()}).encode()


def poses_message(
    t_s: float, person_id: Array, xyz_world: Array, cov_world: Array | None = None, *, rgba: Sequence[Sequence[int]] | None = None
) -> bytes:
    """People of one time step.

    Args:
        person_id: (N,). xyz_world: (N, K, 3) metres. cov_world: (N, K, 3, 3) for ellipsoids of two standard deviations.
        rgba: (N, 4) 0..255; None: the bones' own colours.
    """
    people, keypoints = xyz_world.shape[:2]
    colours = np.zeros((people, 4), np.uint8) if rgba is None else np.asarray(rgba, np.uint8).reshape(people, 4)
    ids = np.ascontiguousarray(person_id, "<u4").view(np.uint8).reshape(people, 4)
    parts = [
        packed_header(POSES, t_s),
        struct.pack("<HHI", people, keypoints, _ELLIPSOIDS if cov_world is not None else 0),
        np.hstack([ids, colours]).tobytes(),
        np.ascontiguousarray(xyz_world, "<f4").tobytes(),
    ]
    if cov_world is not None:
        parts.append(np.ascontiguousarray(ellipsoid_factors(cov_world), "<f4").tobytes())
    return b"".join(parts)


def ellipsoid_factors(cov: Array, sigmas: float = 2.0) -> Array:
    """(..., 3, 3) lower triangular L with ``L L^T = sigmas^2 cov``; NaN for covariances that are unknown or too large to draw."""
    scaled = np.asarray(cov, float) * sigmas**2
    diagonal = np.diagonal(scaled, axis1=-2, axis2=-1)
    good = np.isfinite(scaled).all(axis=(-2, -1)) & (diagonal > 0).all(axis=-1) & (diagonal.max(axis=-1) < _LARGEST_M**2)
    # as much on the diagonal as rounding can take away
    safe = np.where(good[..., None, None], scaled, np.eye(3)) + 1e-12 * np.eye(3)
    try:
        found = np.linalg.cholesky(safe)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(safe)
        found = vectors * np.sqrt(np.clip(values, 0.0, None))[..., None, :]
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
    seen, fused = (np.zeros((0, keypoints, 2)) if one is None or not len(one) else one for one in (detected_px, projected_px))
    counts = np.array([camera, *size_wh, len(seen), len(fused), keypoints, 0, 0], "<u2").tobytes()
    colours = np.zeros((len(fused), 4), np.uint8)
    colours[: len(rgba)] = np.asarray(rgba, np.uint8).reshape(-1, 4)
    points = [np.ascontiguousarray(one, "<f4").tobytes() for one in (seen, fused)]
    return b"".join([packed_header(IMAGE, t_s), counts, colours.tobytes(), *points, jpeg])


def values_message(t_s: float, values: Array, sigmas: Array) -> bytes:
    """Values (V,) of the plots with their standard deviations, NaN where unknown."""
    both = np.stack([values, sigmas], axis=-1)
    return packed_header(VALUES, t_s) + struct.pack("<I", len(both)) + np.ascontiguousarray(both, "<f4").tobytes()
