"""Rendering in several processes: each draws whole runs of frames of one camera and stores them by itself."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posefuse.core import Camera, InputError, PosefuseError
from posefuse.core.arrays import Array
from posefuse.formats.image_folders import write_depth
from posefuse.formats.npz import write_arrays
from posefuse.formats.video import VideoWriter
from posefuse.foundation.requests_to_end import children_ignore_requests, leave_requests_to_parent
from posefuse_sim.cameras import SensorSettings
from posefuse_sim.scene import H264Settings, JpegSettings

from .shot import CameraShooter
from .stage import RenderStage

# tasks waiting per process: enough that none runs dry, few enough that memory stays bounded
_AHEAD = 2


@dataclass(frozen=True, kw_only=True)
class RenderJob:
    """What every process needs to know.

    Attributes:
        model: MuJoCo's. cameras, sensors, rates_hz: one per camera, in the order of the rig.
        flesh_m: (Q,), see `surroundings`. record: how frames are stored. seed: of the sensor noise.
    """

    model: Any
    backend: str
    cameras: tuple[Camera, ...]
    sensors: tuple[SensorSettings, ...]
    rates_hz: tuple[float, ...]
    flesh_m: Array
    record: H264Settings | JpegSettings
    seed: int


@dataclass(frozen=True)
class FrameRun:
    """Frames `frames` of camera number `camera`.

    Attributes:
        video: the .mp4 part, or the folder of images. done: the .npz written last, with what was visible.
    """

    camera: int
    frames: slice
    video: Path
    done: Path


@dataclass(frozen=True, eq=False, kw_only=True)
class RenderTask:
    """A run of F frames of one camera.

    Attributes:
        run: which, and where they are stored. seq: (F,) numbers of the frames. stamp_ns: (F,) times to write.
        poses: (F, moments, M, 7). xyz_world: (F, Q, 3). possible: (F, Q). depth: the folder for depth images.
    """

    run: FrameRun
    seq: Array
    stamp_ns: Array
    poses: Array
    xyz_world: Array
    possible: Array
    depth: Path


def render_all(job: RenderJob, tasks: Iterable[RenderTask], processes: int) -> Iterator[int]:
    """Work through the tasks, which are made one by one as they are needed; yields the number of frames of each done one.

    An error in a process, or closing the iterator (Ctrl-C), stops all processes; finished tasks stay on disk.
    """
    context = get_context("spawn")
    stop = context.Event()
    pool = ProcessPoolExecutor(processes, context, _start, (job, stop))
    waiting: set[Future[int]] = set()
    try:
        for task in tasks:
            with children_ignore_requests():
                waiting.add(pool.submit(_render, task))
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


class _Worker:
    """The one stage of this process, and its cameras."""

    def __init__(self, job: RenderJob, stop: Event) -> None:
        self.job, self.stop = job, stop
        self._stage = RenderStage(job.model, job.backend)
        self._shooters: dict[int, CameraShooter] = {}

    def shooter(self, camera: int) -> CameraShooter:
        if camera not in self._shooters:
            self._shooters[camera] = CameraShooter(self.job.cameras[camera], self.job.sensors[camera], self._stage)
        return self._shooters[camera]


_worker: _Worker | None = None


def _start(job: RenderJob, stop: Event) -> None:
    global _worker
    leave_requests_to_parent()
    cv2.setNumThreads(1)
    _worker = _Worker(job, stop)


def _render(task: RenderTask) -> int:
    assert _worker is not None
    job, run = _worker.job, task.run
    shooter = _worker.shooter(run.camera)
    visible = np.zeros(task.possible.shape, bool)
    with ExitStack() as stack:
        if isinstance(job.record, H264Settings):
            video = VideoWriter(run.video, job.cameras[run.camera].size_wh, job.rates_hz[run.camera], job.record.crf)
            write = stack.enter_context(video).write
        else:
            write = partial(_write_image, run.video, job.record.quality)
        for i, seq in enumerate(task.seq):
            if _worker.stop.is_set():
                return 0
            seed = [job.seed, 41, run.camera, int(seq)]
            shot = shooter.shoot(task.poses[i], task.xyz_world[i], task.possible[i], job.flesh_m, seed)
            visible[i] = shot.visible
            write(shot.image, int(task.stamp_ns[i]))
            if shot.depth is not None:
                write_depth(task.depth, int(task.stamp_ns[i]), shot.depth)
    # written last, and whole or not at all: where it is, the video part is complete
    write_arrays(run.done, {"visible": visible})
    return len(task.seq)


def _write_image(folder: Path, quality: int, image: Array, t_ns: int) -> None:
    path = folder / image_name(t_ns)
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    try:
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error})") from None


def image_name(t_ns: int) -> str:
    """File name of the frame stamped `t_ns`: microseconds, so that names sort by time."""
    return f"{round(t_ns / 1000):012d}.jpg"
