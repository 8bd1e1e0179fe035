"""A live session in a process of its own, for `posefuse.live`: the program that uses the poses cannot delay the output rate.

Its plan is an argument of `serve`; poses, health and news go over the channel, requests come back over it.
"""

from __future__ import annotations

import _thread
import signal
import threading
from contextlib import suppress
from dataclasses import dataclass, replace

from posefuse.core import LiveDetections, LiveHealth, LiveMessage, LivePose, LivePreview, LiveStart, PosefuseError
from posefuse.foundation.channel import Channel, ChannelClosed

from .inputs import rig_of_inputs
from .messages import Requests, Stop
from .session import LivePlan, run_live

_SEND_S, _LOOK_S, _END_SEND_S = 1.0, 0.2, 30.0


@dataclass(frozen=True)
class NewsLine:
    """One line of news."""

    line: str


@dataclass(frozen=True)
class Ended:
    """The session is over; `error` is the reason for a failure, None after a normal end."""

    error: PosefuseError | None


class _Reader:
    """The program's end of a session: what it is given, never waiting for it."""

    def __init__(self, channel: Channel, images: bool) -> None:
        self.takes = (LiveStart, LivePose, LiveHealth, *((LiveDetections, LivePreview) if images else ()))
        self._channel = channel
        # detections of frames without an image stay here
        self._views: dict[str, LiveDetections] = {}

    def take(self, message: LiveMessage) -> None:
        """Send it on; a program that is gone is noticed by the thread of its requests."""
        if isinstance(message, LiveDetections):
            self._views[message.detections.camera] = message
            return
        with suppress(ChannelClosed):
            if isinstance(message, LivePreview) and (view := self._views.get(message.camera)) is not None:
                self._channel.send(view)
            self._channel.send(message)


def serve(channel: Channel, plan: LivePlan, images: bool) -> None:
    """Body of the process: run the session until it ends, it is stopped (it interrupts itself), or no one listens any more.

    `images`: send the cameras' small images, too, each after its detections.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)
    requests = Requests()
    error: PosefuseError | None = None
    try:
        # it may interrupt at once
        threading.Thread(target=_take_requests, args=(channel, requests), daemon=True).start()

        def say(line: str) -> None:
            with suppress(ChannelClosed):
                channel.send(NewsLine(line), _SEND_S)

        rig = rig_of_inputs(plan.rig, plan.inputs, plan.config.camera_info, say)
        run_live(replace(plan, rig=rig), say, reader=_Reader(channel, images), requests=requests)
    except PosefuseError as problem:
        error = problem
    except KeyboardInterrupt:
        pass
    with suppress(ChannelClosed):
        channel.send(Ended(error), _END_SEND_S)


def _take_requests(channel: Channel, requests: Requests) -> None:
    # it also ends when the program that wanted the poses has ended
    with suppress(ChannelClosed):
        while True:
            channel.wait(_LOOK_S)
            while (message := channel.receive()) is not None:
                if isinstance(message, Stop):
                    _thread.interrupt_main()
                    return
                requests.put(message)
    _thread.interrupt_main()
