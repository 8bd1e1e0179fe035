"""SLEAP analysis h5: tracks of instances, laid out as MATLAB reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from posefuse.core import InputError, Skeleton

from .frames import People2D, Pose2DFrames, frames_from_mapping
from .h5 import H5_SUFFIXES, opened
from .keypoint_sets import skeleton_of_names

NAME = "sleap"
_DATASETS = ("tracks", "node_names")


def fits(path: Path) -> bool:
    """Whether this is an h5 with ``tracks`` and ``node_names``."""
    if not path.is_file() or path.suffix not in H5_SUFFIXES:
        return False
    with opened(path) as file:
        return all(name in file for name in _DATASETS)


def read(path: Path, camera: str, skeleton: Skeleton | None = None, size_wh: tuple[int, int] | None = None) -> Pose2DFrames:
    """Frames from 0; a track is a person, its place its id.

    Raises:
        InputError: arrays of other shapes. DependencyError: the extra ``h5`` is missing.
    """
    with opened(path) as file:
        tracks = np.asarray(file["tracks"], np.float64)
        names = [name.decode() if isinstance(name, bytes) else str(name) for name in file["node_names"][()]]
        scores = np.asarray(file["point_scores"], np.float64) if "point_scores" in file else None
    if tracks.ndim != 4 or tracks.shape[1:3] != (2, len(names)):
        raise InputError(f"{path}: tracks: expected (tracks, 2, {len(names)} nodes, frames), got {tracks.shape}")
    xy = tracks.transpose(3, 0, 2, 1)  # (frames, tracks, nodes, 2)
    score = np.isfinite(xy).all(-1).astype(float) if scores is None else scores.transpose(2, 0, 1)
    if score.shape != xy.shape[:3]:
        raise InputError(f"{path}: point_scores: expected (tracks, nodes, frames) like tracks, got {scores.shape}")  # type: ignore[union-attr]
    points = np.concatenate([xy, np.clip(score, 0, 1)[..., None]], axis=-1)
    ids = np.arange(points.shape[1])
    made = skeleton or skeleton_of_names(names, NAME, str(path))
    return frames_from_mapping(camera, NAME, made, {i: People2D(points[i], ids) for i in range(len(points))})
