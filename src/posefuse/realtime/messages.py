"""Messages between camera groups and the fusion. Plain values; times are session time unless stated otherwise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import Detections2D, JointCentres, Skeleton
from posefuse.core.arrays import Array
from posefuse.health.cameras import CameraState


@dataclass(frozen=True)
class Ready:
    """A group has its detector, which marks these keypoints, and its sources; it waits for `Go`."""

    group: int
    skeleton: Skeleton
    joint_centres: JointCentres | None


@dataclass(frozen=True)
class Centres:
    """Offsets of joint centres from the keypoints in the views of some cameras; None: they are the same, or not known."""

    cameras: tuple[str, ...]
    table: JointCentres | None


@dataclass(frozen=True)
class GroupFailed:
    """A group cannot start; one line with the reason."""

    group: int
    reason: str


@dataclass(frozen=True)
class Go:
    """Begin. `zero_ns` is the monotonic time at which recorded and simulated sources show their time 0."""

    zero_ns: int


@dataclass(frozen=True, eq=False)
class Expected:
    """What the fusion expects to be seen next: the newest prediction.

    Attributes:
        t_ns: session time it is for.
        xyz_world: (N, K, 3) people followed; NaN where unknown.
        velocity_world: (N, K, 3) metres per second.
    """

    t_ns: int
    xyz_world: Array
    velocity_world: Array

    def at(self, t_ns: int) -> Array:
        """(N, K, 3) carried on to a time near it."""
        return np.asarray(self.xyz_world + self.velocity_world * ((t_ns - self.t_ns) / 1e9))


NOTHING_EXPECTED = Expected(0, np.zeros((0, 0, 3)), np.zeros((0, 0, 3)))


@dataclass(frozen=True)
class Stop:
    """Finish and leave."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SeenView:
    """One frame looked at.

    Attributes:
        detections: the people in it; its t_ns is mid-exposure.
        state: status of its camera; None where another machine does not send it.
        received_ns: the frame reached its process. started_ns: the detector began. detected_ns: it had finished.
        still: how many frames in a row, this one included, were the same image to the last sampled pixel.
        searched: the whole image was searched for people.
        skipped: the camera's frames since the view before, which came while no person was followed and nothing changed.
    """

    detections: Detections2D
    state: CameraState | None
    received_ns: int
    started_ns: int
    detected_ns: int
    still: int = 0
    searched: bool = False
    skipped: int = 0


@dataclass(frozen=True)
class Status:
    """A group is alive."""

    group: int
    t_ns: int
    cameras: tuple[CameraState, ...]


@dataclass(frozen=True)
class VideoFailed:
    """A camera's video ended early; one line with the reason."""

    camera: str
    reason: str
