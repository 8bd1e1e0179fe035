"""What is left of the difference between camera clocks, found again and again from the moving person.

The work is `clock_finding`; it runs in a process of its own, so that the beat never waits for it.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator, Mapping
from functools import cache

import numpy as np

from posefuse.core import Detections2D, Rig, Skeleton
from posefuse.core.arrays import Array

from .channel import Channel, ChannelClosed
from .clock_finding import ClockFinder
from .processes import ended, spawned

_S = 1e9
_NICENESS = 10
_WAIT_S = 0.2
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
# what moves most tells most about time; the rest of the skeleton would only cost
_TELLING = tuple(
    f"{side}_{part}" for side in ("left", "right") for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
)


class ClockOffsets:
    """Offsets of all cameras' stamps. Use as a context manager: leaving it ends the process."""

    def __init__(self, rig: Rig) -> None:
        self._names = rig.names
        self._offset_s = dict.fromkeys(rig.names, float("nan"))
        self._channel, theirs = Channel.pair()
        with _one_thread():
            self._process = spawned(run_clocks, rig, theirs, name="posefuse clocks")
        theirs.close_own()

    def __enter__(self) -> ClockOffsets:
        return self

    def __exit__(self, *problem: object) -> None:
        self._channel.close()
        ended(self._process, 0.3)

    @property
    def offset_s(self) -> Mapping[str, float]:
        """How much later each camera's stamps are than the mean of all; NaN until that is known."""
        return dict(self._offset_s)

    def corrected_ns(self, view: Detections2D) -> int:
        """The view's stamp with what was found taken away; the view goes into the next finding."""
        with contextlib.suppress(ChannelClosed):
            if len(view) == 1:
                told = telling_points(view.skeleton)
                self._channel.send((view.camera, view.t_ns, view.xy_img[0, told], view.score[0, told]))
            while (found := self._channel.receive()) is not None:
                self._offset_s = found
        offset_s = self._offset_s[view.camera]
        return view.t_ns if np.isnan(offset_s) else view.t_ns - round(offset_s * _S)


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Processes started meanwhile compute in one thread: waiting for each other, several would only take from the cameras."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            os.environ.update({name: value} if value is not None else {})


@cache
def telling_points(skeleton: Skeleton) -> Array:
    """Indices of the keypoints that tell most; all of a skeleton that has none of them."""
    found = [k for k, name in enumerate(skeleton.keypoints) if name in _TELLING]
    return np.array(found or range(len(skeleton)))


def run_clocks(rig: Rig, channel: Channel) -> None:
    """Body of the process: collects views, tells offsets."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with contextlib.suppress(OSError):
        os.nice(_NICENESS)
    finder = ClockFinder(rig)
    with contextlib.suppress(ChannelClosed):
        while True:
            channel.wait(_WAIT_S)
            while (view := channel.receive()) is not None:
                finder.add(*view)
            if (found := finder.find()) is not None:
                channel.send({name: found.get(name, float("nan")) for name in rig.names})
    os._exit(0)
