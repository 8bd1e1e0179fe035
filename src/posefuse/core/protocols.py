"""What a plug-in must offer. Its config is a light frozen dataclass whose `build()` returns one of these."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Protocol, Self, runtime_checkable

# the help of a command needs `Progress` and none of these
if TYPE_CHECKING:
    from .frames import Frame
    from .joint_centres import JointCentres
    from .live_messages import LiveMessage
    from .recording import Recording
    from .skeleton import Skeleton
    from .values import Detections2D, Region


@runtime_checkable
class Source(Protocol):
    """One camera's frames."""

    @property
    def camera(self) -> str:
        """Name of the camera."""
        ...

    @property
    def size_wh(self) -> tuple[int, int]:
        """(width, height) of every frame in px."""
        ...

    def frames(self) -> Iterator[Frame]:
        """Frames in time order, seq counting from the first. A second call starts from the beginning (a live source continues).

        Raises:
            SourceError: it cannot be opened, or fails on the way.
        """
        ...

    def close(self) -> None:
        """Release files, devices and threads; safe to call twice, and while another thread waits for a frame."""
        ...


# what a detector states under "unknown" in its `network` where its standard deviations are a rule of thumb
NOISE_NOT_FITTED = "noise not fitted"


@runtime_checkable
class Detector(Protocol):
    """Images to 2D keypoints."""

    @property
    def skeleton(self) -> Skeleton:
        """Names axis K of what `detect` returns."""
        ...

    @property
    def joint_centres(self) -> JointCentres | None:
        """How far anatomical joint centres lie from the keypoints.

        None where that was not fitted, or where the keypoints are joint centres already.
        """
        ...

    def detect(self, frames: Sequence[Frame], regions: Sequence[Sequence[Region] | None]) -> list[Detections2D]:
        """One Detections2D per frame, in order.

        `regions[i]` are the regions of people in frame i, one person each and in that order (a person that is not there
        comes back as NaN with score 0); None means: find them.
        """
        ...


@runtime_checkable
class Sink(Protocol):
    """A finished recording to files."""

    @property
    def name(self) -> str:
        """Short name, e.g. ``trc``."""
        ...

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write into an existing folder; returns the files made."""
        ...


class Closing(ABC):
    """A context manager that is closed where its block ends."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *problem: object) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """End the work and release what is held."""


@runtime_checkable
class LiveOutput(Protocol):
    """Messages of a live session to a file, network or viewer, in a thread of its own.

    What it raises is reported as its failure; it is then closed and built again after a while.
    """

    @property
    def name(self) -> str:
        """Short name, e.g. ``osc``."""
        ...

    @property
    def where(self) -> str:
        """File or address it writes to now, for messages to the user; may be empty."""
        ...

    def take(self, message: LiveMessage) -> None:
        """Take the next message: first a `LiveStart`, then those of its config's `takes` in the order of the session.

        Raises:
            PosefuseError, OSError: it cannot be opened or written.
        """
        ...

    def close(self) -> None:
        """Finish; safe to call twice, and before anything was taken."""
        ...


@runtime_checkable
class LiveOutputConfig(Protocol):
    """Config of a live output: a frozen dataclass that can be sent to another process.

    Attributes:
        takes: classes of `core.live_messages` that the output accepts, in addition to `LiveStart`.
        keeps_all: it gets every message that fits into its queue (a recording); otherwise only the newest when it falls behind.
    """

    takes: ClassVar[tuple[type[LiveMessage], ...]]
    keeps_all: ClassVar[bool]

    def build(self) -> LiveOutput:
        """The output, not yet opened; raises DependencyError where a package is missing."""
        ...


# Progress reports of long work; the terminal, a notebook and the browser show them.


class Progress(Protocol):
    """Is called whenever there is something to report; must return quickly and may be called often.

    Args (of the call):
        stage: what is being done, e.g. ``detect`` or ``write``; a new name begins a new stage.
        done: steps finished. total: of how many; None where that is not known.
        message: a line of news to show; empty when only the numbers have changed.
    """

    def __call__(self, stage: str, done: int, total: int | None, message: str = "") -> None:
        """Take a report."""
        ...


def silent(stage: str, done: int, total: int | None, message: str = "") -> None:
    """The `Progress` that shows nothing."""
