"""Views of camera nodes on other machines, as a live session takes them."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence

from posefuse.core import Skeleton, SourceError
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.foundation.channel import Channel
from posefuse.foundation.platform import peak_memory_mb
from posefuse.health.cameras import Verdict

from .clock import SessionClock
from .config import LiveConfig
from .controls import KeepVideos, ShowImages
from .messages import Centres, SeenView
from .network_intake import NetworkIntake
from .news import Say
from .session import ready_tracker

_S = 1_000_000_000
_FIRST_VIEW_S = 0.5


class NetworkViews:
    """Views of other machines, as `session.SessionViews`. Use as a context manager: leaving it closes them."""

    restarts = 0

    def __init__(self, intake: NetworkIntake, config: LiveConfig, duration_s: float | None, say: Say) -> None:
        self.intake = intake
        self._config, self._duration_s, self._say = config, duration_s, say
        self._begun_ns = intake.clock.now_ns()

    def __enter__(self) -> NetworkViews:
        return self

    def __exit__(self, *problem: object) -> None:
        self.intake.close()

    def wait_ready(self, stopped: Sequence[str]) -> Skeleton:
        """The skeleton of the first view."""
        # compiled for any skeleton, before a view is there to be waited for
        ready_tracker(self.intake.rig, BLAZEPOSE33, self._config)
        while (skeleton := self.intake.first_skeleton(_FIRST_VIEW_S)) is None:
            if stopped or (self._duration_s is not None and self._waited_s() >= self._duration_s):
                raise SourceError(self._nothing_came())
        self._say(f"first view after {self._waited_s():.1f} s")
        return skeleton

    def whereabouts(self) -> list[str]:
        """In no process of this machine."""
        return []

    def centres(self) -> list[Centres]:
        """They come with the views."""
        return []

    def start(self, clock: SessionClock) -> int:
        """They come already; the session counts from when it began to wait for them."""
        return self._begun_ns

    def control(self, request: ShowImages | KeepVideos) -> None:
        """Cameras of other machines take no requests: images and videos are switched by their own nodes' options."""

    def channels(self) -> list[Channel]:
        """For `select`."""
        return self.intake.channels()

    def messages(self) -> Iterator[SeenView | Centres]:
        """What has come; never waits."""
        return self.intake.messages()

    def troubles(self) -> Mapping[str, Verdict]:
        """See `NetworkIntake`."""
        return self.intake.troubles()

    def notices(self) -> list[str]:
        """Why messages are refused."""
        return self.intake.notices()

    def memory_mb(self) -> float:
        """Most memory this process has held."""
        return peak_memory_mb([os.getpid()])

    def _waited_s(self) -> float:
        return (self.intake.clock.now_ns() - self._begun_ns) / _S

    def _nothing_came(self) -> str:
        counts, strangers = self.intake.views.intake.counts, self.intake.views.senders.strangers
        why = f"; {counts.refused} messages were refused, the last because: {counts.last_refusal}" if counts.refused else ""
        others = f"; there are views of {', '.join(sorted(strangers))}, not in the rig" if strangers else ""
        return f"no view of any camera of the rig came{why}{others}; are the camera nodes in the same domain?"
