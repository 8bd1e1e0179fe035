"""Guidance at the cameras: what the waving has covered so far, told and shown until it is enough."""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import cv2

from posefuse.calibration.targets.detection import TargetDetector
from posefuse.calibration.targets.guidance import Guidance, seen, start
from posefuse.calibration.targets.kinds import Target
from posefuse.cli.terminal import Terminal
from posefuse.core import Frame, PosefuseError
from posefuse.formats.rig import read_rig
from posefuse.outputs.rerun_scene import SPAWN
from posefuse.realtime.capture import LiveInput
from posefuse.realtime.inputs import inputs_from_arguments

from .guide_frame import GuideFrame
from .inputs import target_from_arguments

_TELL_EVERY_S, _REST_S = 1.0, 0.005


@dataclass
class _Newest:
    """The newest frame of one camera, which its thread sets and the loop takes."""

    frame: Frame | None = None
    received_ns: int = 0
    error: PosefuseError | None = None
    ended: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)

    def take(self) -> tuple[Frame | None, int]:
        with self.lock:
            frame, self.frame = self.frame, None
            return frame, self.received_ns


def guide(
    inputs: Sequence[LiveInput],
    target: Target,
    tell: Callable[[Guidance], None],
    show: Callable[[GuideFrame], None],
    most_s: float | None = None,
) -> Guidance:
    """Watch the cameras until enough is covered, the sources end, or `most_s` is over.

    `tell` is called once a second and at the end, `show` with every frame.

    Raises:
        PosefuseError: what a source raises.
    """
    detector, state = TargetDetector(target), start(tuple(one.camera for one in inputs))
    newest, stop = [_Newest() for _ in inputs], threading.Event()
    threads = [threading.Thread(target=_read, args=(one, slot, stop), daemon=True)
               for one, slot in zip(inputs, newest, strict=True)]  # fmt: skip
    for thread in threads:
        thread.start()
    begin = told = time.monotonic()
    try:
        while not state.enough:
            # asked before the frames are taken, so that the last ones are not lost
            over = all(slot.ended for slot in newest)
            failed = next((slot.error for slot in newest if slot.error is not None), None)
            if failed is not None:
                raise failed
            # all at once, before any is looked at: frames of one moment tell which cameras see the target together
            for camera, (frame, received_ns) in enumerate([slot.take() for slot in newest]):
                if frame is not None:
                    corners = detector.detect(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY))
                    state = seen(state, camera, received_ns, corners.xy_img, frame.size_wh)
                    show(GuideFrame(camera, received_ns, frame, corners, state))
            now = time.monotonic()
            if over or (most_s is not None and now - begin > most_s):
                break
            if now - told >= _TELL_EVERY_S:
                tell(state)
                told = now
            time.sleep(_REST_S)
    finally:
        stop.set()
    tell(state)
    return state


def _read(one: LiveInput, slot: _Newest, stop: threading.Event) -> None:
    try:
        source = one.config.build()
        try:
            for frame in source.frames():
                with slot.lock:
                    slot.frame, slot.received_ns = frame, time.monotonic_ns()
                if stop.is_set():
                    break
        finally:
            source.close()
    except PosefuseError as error:
        slot.error = error
    finally:
        slot.ended = True


def guide_at_cameras(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """The step: a table and what to do next once a second, and a picture of it where it was asked for."""

    def tell(state: Guidance) -> None:
        covered = state.coverage
        rows = [(name, f"{share:.0%}", *counts) for name, share, counts in
                zip(covered.cameras, covered.share, covered.together.tolist(), strict=True)]  # fmt: skip
        terminal.table("seen together with", ("camera", "covered", *covered.cameras), rows)
        terminal.note(state.words)

    inputs = inputs_from_arguments(args.source, read_rig(args.intrinsics))
    with _guide_view(args, [one.camera for one in inputs]) as show:
        found = guide(inputs, target_from_arguments(args), tell, show, args.duration)
    terminal.next("posefuse calibrate extrinsics --help", "the rig from what was recorded" if found.enough else found.words)
    covered = {name: float(share) for name, share in zip(found.coverage.cameras, found.coverage.share, strict=True)}
    return {"enough": found.enough, "covered": covered, "next": found.words}


@contextmanager
def _guide_view(args: argparse.Namespace, cameras: Sequence[str]) -> Iterator[Callable[[GuideFrame], None]]:
    """What to do with every frame: show it where the user asked for."""
    if not (args.view or args.view_file):
        yield lambda look: None
        return
    from .guide_view import GuideView

    view = GuideView(cameras, str(args.view_file or SPAWN))
    try:
        yield view.look
    finally:
        view.close()
