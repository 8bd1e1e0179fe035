"""The seam between detection and the rest: one time step of a recording, which can be looked at."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from posefuse.core import Detections2D, LookKind, Observations, Pose3D
from posefuse.core.arrays import Array
from posefuse.core.duplicate_share import DUPLICATE_SHARE
from posefuse.core.duplicates import duplicates


class TimeStep(Protocol):
    """One time step of a recording."""

    @property
    def t_ns(self) -> int:
        """Session clock."""
        ...

    def look(self, kind: LookKind, expected: Pose3D | None) -> tuple[Detections2D, ...]:
        """What the detector finds in each camera that has a frame, each at its own exposure time, in the order of the rig.

        `expected`: the people to look for; None (in a search): everywhere.
        """
        ...


@dataclass(frozen=True)
class StoredStep:
    """A time step whose detections are known already: the answers come from the log.

    Attributes:
        observations: the log. step: which of its time steps.
        frames: rows of its frame table for this time step.
    """

    observations: Observations
    step: int
    frames: Array

    @property
    def t_ns(self) -> int:
        """Session clock."""
        return int(self.observations.step_t_ns[self.step])

    def look(self, kind: LookKind, expected: Pose3D | None) -> tuple[Detections2D, ...]:
        """The stored answer to this look; where the detector did not look so, all different detections of each frame."""
        return tuple(self._answer(frame, rows) for frame, rows in self.rows(kind))

    def rows(self, kind: LookKind) -> list[tuple[int, Array]]:
        """Where the answers of `look` lie in the log: (row of the frame table, rows of the detection table) of each."""
        log, kinds = self.observations, self.observations.frame_look[self.frames]
        if (kinds == kind).any():
            return [(int(i), np.arange(log.frame_begin[i], log.frame_begin[i + 1])) for i in self.frames[kinds == kind]]
        cameras = log.frame_camera[self.frames]
        by_camera = [self.frames[cameras == camera] for camera in np.unique(cameras)]
        return [(int(frames[0]), self._union(frames)) for frames in by_camera]

    def _answer(self, frame: int, rows: Array) -> Detections2D:
        log = self.observations
        camera, t_ns = log.camera_names[log.frame_camera[frame]], int(log.frame_t_ns[frame])
        return Detections2D(camera=camera, t_ns=t_ns, skeleton=log.skeleton, **log.rows(rows))

    def _union(self, frames: Array) -> Array:
        """Detections of several looks at one frame, each body once, as the last look that found it has it.

        Bodies are distinguished by their keypoints: the boxes of two people who stand close together overlap.
        """
        log, kept = self.observations, np.zeros(0, np.int64)
        for frame in frames[::-1]:
            rows = np.arange(log.frame_begin[frame], log.frame_begin[frame + 1])
            found = np.concatenate([kept, rows[(log.score[rows] > 0).any(axis=1)]])
            # what is kept counts first, however sure it is
            together = replace(self._answer(int(frame), found), score=_in_order(log.score[found], len(kept)))
            kept = np.concatenate([kept, found[len(kept) :][~duplicates(together, DUPLICATE_SHARE)[len(kept) :]]])
        return kept


def _in_order(score: Array, kept: int) -> Array:
    """Scores (P, K) with which the first `kept` are surer than all others."""
    return np.where(score > 0, np.where(np.arange(len(score))[:, None] < kept, 1.0, 1e-3 * score), 0.0)


def stored_steps(observations: Observations) -> Iterator[StoredStep]:
    """The time steps of a log, in order."""
    order = np.argsort(observations.frame_step, kind="stable")
    begin = np.searchsorted(observations.frame_step[order], np.arange(len(observations.step_t_ns) + 1))
    for step in range(len(observations.step_t_ns)):
        yield StoredStep(observations, step, order[begin[step] : begin[step + 1]])
