"""Rendering in several processes: each draws whole runs of frames of one camera and stores them by itself."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from posefuse.core import InputError, PosefuseError
from posefuse.core.arrays import Array
from posefuse.formats.npz import write_arrays
from posefuse.formats.video import VideoWriter
from posefuse.foundation.requests_to_end import HANG_UP, handling, leave_requests_to_parent
from posefuse.outputs.drawing import jpeg_of
from posefuse_sim.build import LiveScene
from posefuse_sim.exact import SeenPoints
from posefuse_sim.files import write_depth
from posefuse_sim.scene import H264Settings

from .shot import CameraShooter, noise_seed
from .stage import RenderStage

# tasks waiting per process: enough that none runs dry, few enough that memory stays bounded
_AHEAD = 2


@dataclass(frozen=True, kw_only=True)
class RenderJob:
    """What every process needs to know.

    Attributes:
        model: MuJoCo's. live: cameras, their shots and settings; without people and props, which do not travel.
        flesh_m: (Q,), see `surroundings`.
    """

    model: Any
    backend: str
    live: LiveScene
    flesh_m: Array


@dataclass(frozen=True)
class FrameRun:
    """Frames `frames` of camera number `camera`.

    Attributes:
        video: the .mp4 part, or the folder of images. depth: the folder of depth images.
        done: the .npz written last, with what was visible.
    """

    camera: int
    frames: slice
    video: Path
    depth: Path
    done: Path


def render_all(job: RenderJob, tasks: Iterable[tuple[FrameRun, Array, SeenPoints]], processes: int) -> Iterator[int]:
    """Work through runs and what they expose (`shot.exposed`), made one by one as they are needed; yields frames of each done.

    An error in a process, or closing the iterator (Ctrl-C), stops all processes; finished tasks stay on disk.
    """
    context = get_context("spawn")
    stop = context.Event()
    pool = ProcessPoolExecutor(processes, context, _start, (job, stop))
    waiting: set[Future[int]] = set()
    try:
        for task in tasks:
            with children_ignore_requests(), _main_left_alone():
                waiting.add(pool.submit(_render, *task))
            if len(waiting) >= processes * _AHEAD:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                yield from (future.result() for future in done)
        while waiting:
            done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in done)
    except BrokenProcessPool:
        raise PosefuseError(
            "rendering: a process was ended from outside (out of memory?); simulate again with fewer processes to continue"
        ) from None
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def children_ignore_requests() -> Iterator[None]:
    """Processes started within ignore Ctrl-C and hang-ups from their start on; `leave_requests_to_parent` keeps it so.

    They would print a trace of what they import just then. Only the main thread can see to it.
    """
    main = threading.current_thread() is threading.main_thread()
    ignored = [signal.SIGINT, *([] if HANG_UP is None else [HANG_UP])] if main else []
    with handling(ignored, signal.SIG_IGN):
        yield


@contextmanager
def _main_left_alone() -> Iterator[None]:
    """Processes started within do not run the main file of the program: without a guard there it would simulate in each."""
    main, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


class _Worker:
    """The one stage of this process, and its cameras."""

    def __init__(self, job: RenderJob, stop: Event) -> None:
        self.job, self.stop = job, stop
        self._stage = RenderStage(job.model, job.backend)
        self._shooters: dict[int, CameraShooter] = {}

    def shooter(self, camera: int) -> CameraShooter:
        if camera not in self._shooters:
            live = self.job.live
            self._shooters[camera] = CameraShooter(live.rig.cameras[camera], live.placed[camera].sensor, self._stage)
        return self._shooters[camera]


_worker: _Worker | None = None


def _start(job: RenderJob, stop: Event) -> None:
    global _worker
    leave_requests_to_parent()
    cv2.setNumThreads(1)
    _worker = _Worker(job, stop)


def _render(run: FrameRun, poses: Array, seen: SeenPoints) -> int:
    assert _worker is not None
    live, shooter = _worker.job.live, _worker.shooter(run.camera)
    record, stamp_ns = live.scene.record, live.shots[run.camera].stamp_ns[run.frames].tolist()
    visible = np.zeros(seen.possible.shape, bool)
    with ExitStack() as stack:
        if isinstance(record, H264Settings):
            rate_hz = live.placed[run.camera].sensor.rate_hz or live.scene.rate_hz
            video = VideoWriter(run.video, live.rig.cameras[run.camera].size_wh, rate_hz, record.crf)
            write = stack.enter_context(video).write
        else:
            write = partial(_write_image, run.video, record.quality)
        for i, t_ns in enumerate(stamp_ns):
            if _worker.stop.is_set():
                return 0
            seed = noise_seed(live, run.camera, run.frames.start + i)
            shot = shooter.shoot(poses[i], seen.xyz_world[i], seen.possible[i], _worker.job.flesh_m, seed)
            visible[i] = shot.visible
            write(shot.image, t_ns)
            if shot.depth is not None:
                write_depth(run.depth, t_ns, shot.depth)
    # written last, and whole or not at all: where it is, the video part is complete
    write_arrays(run.done, {"visible": visible})
    return len(stamp_ns)


def _write_image(folder: Path, quality: int, image: Array, t_ns: int) -> None:
    path = folder / image_name(t_ns)
    try:
        path.write_bytes(jpeg_of(image, quality))
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error})") from None


def image_name(t_ns: int) -> str:
    """File name of the frame stamped `t_ns`: microseconds, so that names sort by time."""
    return f"{round(t_ns / 1000):012d}.jpg"
