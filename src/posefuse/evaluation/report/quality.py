"""How good the data of a recording are, keypoint by keypoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from posefuse.core import Kind, Recording
from posefuse.core.arrays import Array
from posefuse.evaluation.metrics import known_median
from posefuse.formats.page import Cell

QUALITY_COLUMNS = ("keypoint", "measured", "filled", "cameras", "reprojection px", "standard deviation mm", "longest gap s")

CAMERA_COLUMNS = ("camera", "person seen", "of it left out", "reprojection px", "in standard deviations")


@dataclass(frozen=True)
class KeypointQuality:
    """One keypoint of one person over a recording.

    Attributes:
        keypoint: its name. found: share of time steps with a measured 3D point. filled: share filled from neighbours.
        views: median number of cameras used. reproj_px: median reprojection error.
        sigma_mm: median standard deviation, root of the mean variance of the three axes.
        longest_gap_s: longest time without a measured point.
    """

    keypoint: str
    found: float
    filled: float
    views: float
    reproj_px: float
    sigma_mm: float
    longest_gap_s: float


def keypoint_quality(recording: Recording, person: int) -> list[KeypointQuality]:
    """Quality of every keypoint of the person at this place of axis N."""
    poses = recording.poses
    t_s = (poses.t_ns - poses.t_ns[:1]) * 1e-9
    rows = []
    for k, name in enumerate(poses.skeleton.keypoints):
        kind, views = poses.kind[:, person, k], poses.n_views[:, person, k]
        known = np.isfinite(poses.xyz_world[:, person, k, 0])
        measured = known & np.isin(kind, (Kind.FUSED, Kind.SMOOTHED))
        variance = np.trace(poses.cov_world[:, person, k], axis1=-2, axis2=-1) / 3
        rows.append(
            KeypointQuality(
                keypoint=name,
                found=_share(measured),
                filled=_share(known & ~measured),
                views=known_median(views[measured].astype(float)),
                reproj_px=known_median(poses.reproj_px[:, person, k][measured]),
                sigma_mm=1e3 * float(np.sqrt(known_median(variance[known]))),
                longest_gap_s=_longest_gap(t_s, measured),
            )
        )
    return rows


def quality_rows(recording: Recording, person: int) -> list[list[Any]]:
    """Rows under `QUALITY_COLUMNS`; a keypoint that is measured in less than half of the time stands out."""
    return [
        [
            Cell(k.keypoint.replace("_", " "), "" if k.found > 0.5 else "bad"),
            f"{100 * k.found:.0f} %", f"{100 * k.filled:.0f} %", _digits(k.views, 0), _digits(k.reproj_px, 1),
            _digits(k.sigma_mm, 1), _digits(k.longest_gap_s, 2),
        ]
        for k in keypoint_quality(recording, person)
    ]  # fmt: skip


def camera_rows(fits: Mapping[str, Mapping[str, float]]) -> list[list[Any]]:
    """Rows under `CAMERA_COLUMNS` of the fields of `health.recorded.CameraFit`, by camera."""
    return [[name, f"{one['seen']:.0%}", f"{one['left_out']:.0%}", one["reproj_px"], one["sigmas"]] for name, one in fits.items()]


def views_picture(recording: Recording, person: int) -> Array:
    """(K, T', 3) uint8 RGB: how many cameras each keypoint was made from over time; at most 900 columns."""
    views = recording.poses.n_views[:, person].astype(float)
    step = max(1, -(-len(views) // 900))
    padded = np.pad(views, ((0, -len(views) % step), (0, 0)), mode="edge") if len(views) else views
    share = padded.reshape(-1, step, views.shape[1]).mean(axis=1).T / max(1, len(recording.rig))
    none, all_ = np.array([214.0, 84.0, 60.0]), np.array([38.0, 112.0, 150.0])
    few = np.array([244.0, 226.0, 170.0])
    low = none + (few - none) * np.clip(share * 2, 0, 1)[..., None]
    picture = low + (all_ - few) * np.clip(share * 2 - 1, 0, 1)[..., None]
    return np.asarray(np.clip(picture, 0, 255).astype(np.uint8))


def _digits(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def _share(mask: Array) -> float:
    return float(mask.mean()) if len(mask) else float("nan")


def _longest_gap(t_s: Array, measured: Array) -> float:
    if not len(t_s):
        return float("nan")
    at = t_s[measured]
    edges = np.concatenate([[t_s[0]], at, [t_s[-1]]])
    longest = float(np.diff(edges).max())
    usual = float(np.median(np.diff(t_s))) if len(t_s) > 1 else 0.0
    return longest if longest > 1.5 * usual else 0.0
