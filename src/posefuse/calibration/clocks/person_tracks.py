"""One person in each camera over time, chosen from all people that it saw, and which keypoints are good enough to judge by."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import CalibrationError, Detections2D, Skeleton
from posefuse.core.arrays import Array, frozen_fields
from posefuse.core.skeleton import SIDES
from posefuse.core.values import unseen_planes

# Limbs move most, so they carry most information; detectors mark the face even when it is not visible.
_LIMBS = frozenset(f"{side}_{part}" for side in SIDES for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))
# detector score from which a keypoint counts as seen
MIN_SCORE = 0.5


def limb_keypoints(keypoints: Sequence[str]) -> Array:
    """Indices of the limb joints among a skeleton's names; all indices where it has none of them."""
    found = [k for k, name in enumerate(keypoints) if name in _LIMBS]
    return np.array(found or range(len(keypoints)))


@dataclass(frozen=True, eq=False)
class PersonTrack:
    """One camera's person at that camera's own stamps.

    Attributes:
        camera: name. skeleton: names axis K. t_ns: (F,) rising.
        xy_img: (F, K, 2) raw px, NaN where missing. score: (F, K). sigma_px: (F, K), NaN where missing.
    """

    camera: str
    skeleton: Skeleton
    t_ns: Array
    xy_img: Array
    score: Array
    sigma_px: Array

    def __post_init__(self) -> None:
        frozen_fields(self, {"t_ns": "F", "xy_img": "F K 2", "score": "F K", "sigma_px": "F K"})

    @classmethod
    def of(cls, camera: str, frames: Sequence[Detections2D], rows: Iterable[tuple[int, int]]) -> PersonTrack:
        """The person at such places of these frames: pairs of frame and person; NaN in the other frames."""
        planes = unseen_planes((len(frames), len(frames[0].skeleton)))
        for i, p in rows:
            for name, plane in planes.items():
                plane[i] = getattr(frames[i], name)[p]
        return cls(camera, frames[0].skeleton, np.array([frame.t_ns for frame in frames]), **planes)

    @property
    def t_s(self) -> Array:
        """(F,) stamps in seconds."""
        return self.t_ns / 1e9

    def at(self, frames: Array) -> PersonTrack:
        """Only the frames of a mask or of indices."""
        seen = {name: getattr(self, name)[frames] for name in ("t_ns", "xy_img", "score", "sigma_px")}
        return replace(self, **seen)


def person_tracks(detections: Mapping[str, Sequence[Detections2D]]) -> tuple[PersonTrack, ...]:
    """The most prominent person of every camera, followed from frame to frame.

    Prominent is who is large and well scored; a bystander is let go because the one followed is the nearest to the last.
    """
    if len(detections) < 2 or not all(detections.values()):
        blind = ", ".join(name for name, frames in detections.items() if not frames)
        raise CalibrationError(f"person: no person found by {blind}" if blind else "person: expected at least 2 cameras, got 1")
    first, *others = detections
    skeleton = detections[first][0].skeleton
    for name in others:
        if detections[name][0].skeleton != skeleton:
            other = detections[name][0].skeleton
            raise CalibrationError(f"person: {name} has skeleton {other.name}, {first} has {skeleton.name}")
    return tuple(_track(name, frames) for name, frames in detections.items())


def _track(camera: str, detections: Sequence[Detections2D]) -> PersonTrack:
    frames = sorted(detections, key=lambda frame: frame.t_ns)
    rows: list[tuple[int, int]] = []
    last: Array | None = None
    for i, frame in enumerate(frames):
        person = prominent(frame, last)
        if person is not None:
            rows.append((i, person))
            last = _middles(frame)[person]
    return PersonTrack.of(camera, frames, rows)


def prominent(frame: Detections2D, last: Array | None = None) -> int | None:
    """Number of the person who is large and well scored, and near the place `last` (2,) px; None when no person is there."""
    known = np.asarray(np.isfinite(frame.xy_img).all(axis=-1).any(axis=-1))
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
