"""A session as it was asked for, its clock, where views come from, messages of camera groups, requests of its user.

Plain values; times are session time unless stated otherwise.
"""

from __future__ import annotations

import queue
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from posefuse.core import CameraHealth, Detections2D, JointCentres, LiveJointCentres, LiveOutputConfig, Rig, Skeleton
from posefuse.core.arrays import Array
from posefuse.foundation.channel import Channel
from posefuse.health.camera_monitor import CameraState

if TYPE_CHECKING:
    from .capture import LiveInput
    from .config import LiveConfig


@dataclass(frozen=True)
class SessionClock:
    """Unix epoch as it was when the session began, carried on by the machine's monotonic clock: it never jumps.

    Attributes:
        offset_ns: session time minus monotonic time, the same in every process of the machine.
    """

    offset_ns: int

    @staticmethod
    def begin() -> SessionClock:
        """A clock that agrees with the machine's own now."""
        return SessionClock(time.time_ns() - time.monotonic_ns())

    def now_ns(self) -> int:
        """Session time."""
        return time.monotonic_ns() + self.offset_ns


@dataclass(frozen=True, eq=False, kw_only=True)
class LivePlan:
    """A session as it was asked for; all of it is checked.

    Attributes:
        rig: all calibrated cameras. inputs: sources of those of this machine that take part. outputs: configs by name.
        duration_s: the session ends after this time; None: no limit.
    """

    rig: Rig
    inputs: tuple[LiveInput, ...]
    config: LiveConfig
    outputs: Mapping[str, LiveOutputConfig]
    duration_s: float | None = None


@dataclass(frozen=True)
class Ready:
    """A group has its detector, which marks these keypoints, and its sources; it waits for `Go`.

    Attributes:
        noise_fitted: False where the standard deviations of the detector are a rule of thumb.
    """

    skeleton: Skeleton
    joint_centres: JointCentres | None
    noise_fitted: bool = True


@dataclass(frozen=True)
class CannotStart:
    """A process cannot start; one line with the reason."""

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
        velocity_world: (N, K, 3) metres per second. Regions that are off by 50 ms of a walk
            make 2D keypoints 2 % worse in the median.
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
        skipped: the camera's frames since the view before, which came while no person was followed and nothing changed.
    """

    detections: Detections2D
    state: CameraState | None
    received_ns: int
    started_ns: int
    detected_ns: int
    still: int = 0
    skipped: int = 0


@dataclass(frozen=True)
class Status:
    """A group is alive. `video_faults`: why videos ended early, or could not be made, by camera."""

    t_ns: int
    cameras: tuple[CameraState, ...]
    video_faults: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class ShowImages:
    """Small images per second and camera from now on; 0 for none."""

    rate_hz: float


@dataclass(frozen=True)
class KeepVideos:
    """Keep every camera's video in an existing folder from now on; None: no longer."""

    folder: Path | None


@dataclass(frozen=True)
class AddOutput:
    """Open another output."""

    name: str
    config: LiveOutputConfig


@dataclass(frozen=True)
class RemoveOutput:
    """Finish and close an output."""

    name: str


@dataclass(frozen=True)
class NamePerson:
    """Call a person so from now on; empty: no longer."""

    person: int
    name: str


Request = ShowImages | KeepVideos | AddOutput | RemoveOutput | NamePerson
Requests = queue.SimpleQueue[Request]
"""From any thread to the session's."""


class ViewSource(Protocol):
    """Where the views of a session come from: camera groups of this machine, or a network, which has no processes here."""

    def channels(self) -> list[Channel]:
        """For `select`."""
        ...

    def messages(self) -> Iterable[Any]:
        """What has come; never waits. What is not taken is there the next time."""
        ...

    def expect(self, expected: Expected) -> None:
        """Where cameras should look for people next; never waits. Those of other machines take it from the outputs."""
        return

    def troubles(self) -> Mapping[str, CameraHealth]:
        """What is wrong with the process of a camera, by camera."""
        return {}

    @property
    def restarts(self) -> int:
        """How often a process had to be started again."""
        return 0

    @property
    def pids(self) -> Sequence[int]:
        """Processes of the cameras."""
        return ()

    def wait_ready(self, stopped: Sequence[str]) -> Skeleton:
        """Wait for the first sign of all that is needed; gives up when `stopped` has an entry.

        Raises:
            SourceError: no views will come, and why.
            KeyboardInterrupt: stopped before there was anything to finish.
        """
        ...

    def whereabouts(self) -> list[str]:
        """Which work is done in which process, in words."""
        return []

    def notices(self) -> list[str]:
        """Notes about the sources of views, each line once."""
        ...

    def centres(self) -> list[LiveJointCentres]:
        """What is known of joint centres by now; more may come with the views."""
        return []

    @property
    def noise_fitted(self) -> bool:
        """False where standard deviations are a rule of thumb; nodes of other machines do not send that."""
        return True

    def start(self, clock: SessionClock) -> int:
        """Let views come; session time of the session's 0 s."""
        ...

    def control(self, request: ShowImages | KeepVideos) -> None:
        """Change what cameras give besides views; options of their own nodes do so for cameras of other machines."""
        return
