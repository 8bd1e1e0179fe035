"""Where the views of a live session come from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

from posefuse.core import Skeleton
from posefuse.foundation.channel import Channel
from posefuse.health.cameras import Verdict

from .clock import SessionClock
from .controls import KeepVideos, ShowImages
from .messages import Centres, Expected


class ViewSource(Protocol):
    """Where the views of a session come from: camera groups of this machine, or a network."""

    def channels(self) -> list[Channel]:
        """For `select`."""
        ...

    def messages(self) -> Iterable[Any]:
        """What has come; never waits. What is not taken is there the next time."""
        ...

    def expect(self, expected: Expected) -> None:
        """Where cameras should look for people next; never waits."""
        ...

    def troubles(self) -> Mapping[str, Verdict]:
        """What is wrong with the process or machine of a camera, by camera."""
        ...

    @property
    def restarts(self) -> int:
        """How often a process had to be started again."""
        ...

    def wait_ready(self, stopped: Sequence[str]) -> Skeleton:
        """Wait for the first sign of all that is needed; gives up when `stopped` has an entry.

        Raises:
            SourceError: no views will come, and why.
            KeyboardInterrupt: stopped before there was anything to finish.
        """
        ...

    def whereabouts(self) -> list[str]:
        """Which work is done in which process, in words."""
        ...

    def notices(self) -> list[str]:
        """Notes about the sources of views, each line once."""
        ...

    def centres(self) -> list[Centres]:
        """What is known of joint centres by now."""
        ...

    def start(self, clock: SessionClock) -> int:
        """Let views come; session time of the session's 0 s."""
        ...

    def control(self, request: ShowImages | KeepVideos) -> None:
        """Change what cameras give besides views."""
        ...

    def memory_mb(self) -> float:
        """Most memory this process and those of the cameras have held, added up."""
        ...
