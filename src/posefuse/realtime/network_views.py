"""Views of camera nodes on other machines, as a live session takes them."""

from __future__ import annotations

import os
from collections.abc import Sequence

from posefuse.core import Rig, Skeleton, SourceError
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.foundation.platform import peak_memory_mb
from posefuse.messages.dds_domain import Network

from .clock import SessionClock
from .config import LiveConfig
from .controls import KeepVideos, ShowImages
from .messages import Centres, Expected
from .network_intake import NetworkIntake
from .news import Say
from .session import ready_tracker

_S = 1_000_000_000
_FIRST_VIEW_S = 0.5


class NetworkViews(NetworkIntake):
    """Views of other machines for a session; implements `ViewSource`. Use as a context manager: leaving it closes them."""

    restarts = 0

    def __init__(
        self, rig: Rig, network: Network, clock: SessionClock, config: LiveConfig, duration_s: float | None, say: Say
    ) -> None:
        super().__init__(rig, network, clock, hand_over_s=config.hand_over_s)
        self._config, self._duration_s, self._say = config, duration_s, say
        self._begun_ns = clock.now_ns()

    def __enter__(self) -> NetworkViews:
        return self

    def __exit__(self, *problem: object) -> None:
        self.close()

    def wait_ready(self, stopped: Sequence[str]) -> Skeleton:
        """The skeleton of the first view."""
        # compiled for any skeleton, before a view is there to be waited for
        ready_tracker(self.rig, BLAZEPOSE33, self._config)
        while (skeleton := self.first_skeleton(_FIRST_VIEW_S)) is None:
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

    def expect(self, expected: Expected) -> None:
        """Nothing to do: camera nodes take the predictions that the output sends."""

    def control(self, request: ShowImages | KeepVideos) -> None:
        """Cameras of other machines take no requests: images and videos are switched by their own nodes' options."""

    def memory_mb(self) -> float:
        """Most memory this process has held."""
        return peak_memory_mb([os.getpid()])

    def _waited_s(self) -> float:
        return (self.clock.now_ns() - self._begun_ns) / _S

    def _nothing_came(self) -> str:
        counts, strangers = self.views.intake.counts, self.views.senders.strangers
        why = f"; {counts.refused} messages were refused, the last because: {counts.last_refusal}" if counts.refused else ""
        others = f"; there are views of {', '.join(sorted(strangers))}, not in the rig" if strangers else ""
        return f"no view of any camera of the rig came{why}{others}; are the camera nodes in the same domain?"
