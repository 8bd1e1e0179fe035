"""One person in all cameras, out of whoever each camera saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import CalibrationError, Detections2D, Skeleton
from posefuse.core.arrays import Array, check_axes, frozen


@dataclass(frozen=True, eq=False)
class PersonViews:
    """One person in all cameras.

    Attributes:
        cameras: names. skeleton: names axis K. t_ns: (T,).
        xy_img: (C, T, K, 2) raw px, NaN where missing. score: (C, T, K). sigma_px: (C, T, K), NaN where missing.
    """

    cameras: tuple[str, ...]
    skeleton: Skeleton
    t_ns: Array
    xy_img: Array
    score: Array
    sigma_px: Array

    def __post_init__(self) -> None:
        axes = {"t_ns": "T", "xy_img": "C T K 2", "score": "C T K", "sigma_px": "C T K"}
        for name in axes:
            dtype = np.int64 if name == "t_ns" else np.float64
            object.__setattr__(self, name, frozen(getattr(self, name), dtype, f"PersonViews.{name}"))
        check_axes("PersonViews", {name: (getattr(self, name), text) for name, text in axes.items()})

    def at(self, instants: Array) -> PersonViews:
        """Only the instants of a mask or of indices."""
        return replace(
            self, t_ns=self.t_ns[instants], xy_img=self.xy_img[:, instants], score=self.score[:, instants],
            sigma_px=self.sigma_px[:, instants],
        )  # fmt: skip


def person_views(detections: Mapping[str, Sequence[Detections2D]]) -> PersonViews:
    """The most prominent person of every camera, followed from frame to frame, at the times of the camera with most frames.

    Prominent is who is large and well scored; a bystander is let go because the one followed is the nearest to the last.
    """
    if len(detections) < 2 or not all(detections.values()):
        empty = [name for name, frames in detections.items() if not frames]
        raise CalibrationError(f"person: expected detections of at least 2 cameras, got {len(detections)}; empty: {empty}")
    names = tuple(detections)
    longest = max(names, key=lambda name: len(detections[name]))
    t_ns = np.array([frame.t_ns for frame in detections[longest]], dtype=np.int64)
    skeleton = detections[longest][0].skeleton
    period = int(np.median(np.diff(t_ns))) if len(t_ns) > 1 else 1
    xy = np.full((len(names), len(t_ns), len(skeleton), 2), np.nan)
    score, sigma = np.zeros(xy.shape[:3]), np.full(xy.shape[:3], np.nan)
    for c, name in enumerate(names):
        frames = sorted(detections[name], key=lambda frame: frame.t_ns)
        if frames[0].skeleton != skeleton:
            raise CalibrationError(f"person: {name} has skeleton {frames[0].skeleton.name}, {longest} has {skeleton.name}")
        stamps = np.array([frame.t_ns for frame in frames])
        followed = _follow(frames)
        for i, t in enumerate(t_ns):
            k = int(np.argmin(np.abs(stamps - t)))
            person = followed[k]
            if person is not None and abs(int(stamps[k]) - int(t)) <= period // 2:
                xy[c, i], score[c, i], sigma[c, i] = frames[k].xy_img[person], frames[k].score[person], frames[k].sigma_px[person]
    return PersonViews(names, skeleton, t_ns, xy, score, sigma)


def _follow(frames: Sequence[Detections2D]) -> list[int | None]:
    followed: list[int | None] = []
    last: Array | None = None
    for frame in frames:
        person = prominent(frame, last)
        followed.append(person)
        last = last if person is None else _middles(frame)[person]
    return followed


def prominent(frame: Detections2D, last: Array | None = None) -> int | None:
    """Number of the person who is large and well scored, and near the place `last` (2,) px; None when nobody is there."""
    known = np.isfinite(frame.xy_img).all(axis=-1).any(axis=-1)
    if not known.any():
        return None
    xy = np.where(known[:, None, None], frame.xy_img, 0.0)
    size = np.linalg.norm(np.nanmax(xy, axis=1) - np.nanmin(xy, axis=1), axis=1)
    worth = np.where(known, size * frame.score.mean(axis=1), -1.0)
    if last is not None:
        away = np.nan_to_num(np.linalg.norm(_middles(frame) - last, axis=1), nan=np.inf)
        worth = worth / (1 + away / np.maximum(size, 1))
    return int(np.argmax(worth))


def _middles(frame: Detections2D) -> Array:
    """(P, 2) median keypoint of each person; NaN of one without any."""
    return np.array([np.nanmedian(xy, axis=0) if np.isfinite(xy).any() else (np.nan, np.nan) for xy in frame.xy_img])
