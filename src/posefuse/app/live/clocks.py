"""What is left of the difference between camera clocks, found again and again from the moving person.

The work is `calibrate.sync`: where two cameras' stamps disagree, a moving point leaves its epipolar line. It runs in a
process of its own on the newest seconds, so that the beat never waits for it.
"""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections import deque
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from posefuse.core import CalibrationError, Detections2D, Rig, Skeleton
from posefuse.core.arrays import Array

from .channel import Channel, ChannelClosed
from .processes import ended, spawned

_S = 1e9
_KEPT_S = 8.0
_EVERY_S = 2.0
_LEAST_FRAMES = 60
_LEAST_SCORE = 0.5
_TRUSTED_S = 0.005
_BLEND = 0.5
# pairs that disagree with the rest by more than this count less and less
_USUAL_S = 0.004
_ROUNDS = 20
_NICENESS = 10
# the process rests for so many times as long as it worked: on a small machine a finding takes seconds
_REST = 2.0
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
    kept: dict[str, deque[Any]] = {name: deque() for name in rig.names}
    known: dict[str, float] = {}
    next_s = time.monotonic() + _EVERY_S
    with contextlib.suppress(ChannelClosed):
        while True:
            channel.wait(0.2)
            while (message := channel.receive()) is not None:
                camera, *view = message
                _keep(kept[camera], view)
            begun_s = time.monotonic()
            if begun_s >= next_s:
                known = blended(known, found_offsets(rig, kept))
                channel.send({name: known.get(name, float("nan")) for name in rig.names})
                ended_s = time.monotonic()
                next_s = ended_s + max(_EVERY_S, _REST * (ended_s - begun_s))
    os._exit(0)


def _keep(views: deque[Any], view: Sequence[Any]) -> None:
    if views and view[0] <= views[-1][0]:
        return
    views.append(view)
    while view[0] - views[0][0] > _KEPT_S * _S:
        views.popleft()


def blended(before: Mapping[str, float], now: Mapping[str, float]) -> dict[str, float]:
    """Offsets that follow the newest finding half way; new ones at once. Their mean is 0."""
    mixed = {name: before.get(name, value) + _BLEND * (value - before.get(name, value)) for name, value in now.items()}
    kept = {**before, **mixed}
    mean = sum(kept.values()) / len(kept) if kept else 0.0
    return {name: value - mean for name, value in kept.items()}


def found_offsets(rig: Rig, kept: Mapping[str, Sequence[Any]]) -> dict[str, float]:
    """Offsets in s, about their mean, of the cameras whose pictures can be compared.

    Args:
        kept: per camera (t_ns, xy_img (K, 2), score (K,)), oldest first.
    """
    from posefuse.calibrate.sync import Track, estimate_clocks

    ready = [name for name in rig.names if len(kept[name]) >= _LEAST_FRAMES]
    if len(ready) < 2:
        return {}
    zero_ns = kept[ready[0]][0][0]
    tracks = {
        name: Track(
            np.array([(t_ns - zero_ns) / _S for t_ns, _, _ in kept[name]]),
            np.array([np.where((score >= _LEAST_SCORE)[:, None], xy, np.nan) for _, xy, score in kept[name]], np.float64),
        )
        for name in ready
    }
    pairs = []
    for i, one in enumerate(ready):
        for other in ready[i + 1 :]:
            with contextlib.suppress(CalibrationError):
                estimate = estimate_clocks(rig.only((one, other)), (tracks[one], tracks[other]))
                if estimate.offset_sigma_s[1] < _TRUSTED_S:
                    pairs.append((i, ready.index(other), float(estimate.offset_s[1])))
    return agreed(ready, pairs)


def agreed(names: Sequence[str], pairs: Sequence[tuple[int, int, float]]) -> dict[str, float]:
    """Offsets about their mean that fit the differences of pairs (one, other, other minus one) best, wild ones left aside.

    Cameras that no chain of pairs joins to the most others are left out.
    """
    joined = _joined(len(names), pairs)
    used = [(i, j, late_s) for i, j, late_s in pairs if i in joined]
    if not used:
        return {}
    rows = np.zeros((len(used) + 1, len(names)))
    for row, (i, j, _) in zip(rows, used, strict=False):
        row[i], row[j] = -1.0, 1.0
    rows[-1, sorted(joined)] = 1.0
    late = np.array([late_s for _, _, late_s in used] + [0.0])
    weight = np.ones(len(late))
    for _ in range(_ROUNDS):
        root = np.sqrt(weight)
        offset_s = np.linalg.lstsq(rows * root[:, None], late * root, rcond=None)[0]
        weight = 1 / (1 + ((rows @ offset_s - late) / _USUAL_S) ** 2)
    return {names[i]: float(offset_s[i]) for i in sorted(joined)}


def _joined(count: int, pairs: Sequence[tuple[int, int, float]]) -> set[int]:
    """The largest set of cameras that pairs join."""
    label = list(range(count))
    for i, j, _ in pairs:
        label = [label[i] if value == label[j] else value for value in label]
    largest = max(set(label), key=label.count)
    return {i for i in range(count) if label[i] == largest}
