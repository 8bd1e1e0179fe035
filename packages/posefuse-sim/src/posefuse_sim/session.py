"""A simulated session on disk, as `posefuse track` takes it, with the truth next to it.

SESSION/rig.toml              the exact cameras
SESSION/videos/<camera>.mp4   H.264 with the camera's own time stamps; or <camera>/ with images and timestamps.csv
SESSION/depth/<camera>/       `formats.image_folders`, of cameras with depth
SESSION/scene.yaml            every setting, defaults written out
SESSION/truth/truth.npz       `posefuse.formats.truth`
SESSION/truth/shots.npz       per camera number i: seq<i>, t<i>_ns (true), stamp<i>_ns (in the video)
SESSION/posefuse-folder.json  `foundation.output_folder`: the command that made it

It is made in a staging folder (`foundation.output_folder`). What an interrupted run left there is continued by the next run of
the same scene: runs of frames that are whole are not rendered again.
"""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import av
import numpy as np

from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.core.errors import warn_caller
from posefuse.formats.npz import read_arrays, write_arrays
from posefuse.formats.rig import write_rig
from posefuse.formats.video import MP4_OPTIONS, TIME_BASE, open_mp4
from posefuse.foundation.output_folder import check_replaceable, find_unfinished, output_folder
from posefuse.foundation.platform import usable_cores

from .build import LiveScene, live_scene
from .exact import flesh_of_points, truth_with
from .files import write_frame_times, write_truth
from .render.model import render_model
from .render.shot import exposed, moments_of
from .render.stage import working_backend
from .render.workers import FrameRun, RenderJob, image_name, render_all
from .scene import SCENE_FILE, H264Settings, Scene, motion_files, scene_text

Progress = Callable[[int, int], None]
_COMMAND = "simulate"


def simulate(
    scene: Scene,
    out: Path,
    progress: Progress = lambda done, total: None,
    processes: int | None = None,
    *,
    replace: bool = False,
) -> SessionPaths:
    """Render a scene into the folder `out`, or continue where an interrupted run of the same scene stopped.

    Args:
        progress: called with (frames done, frames in all) after every run of frames.
        processes: how many render at once; None takes one per core.
        replace: an earlier session is moved to ``NAME.replaced-TIME``, and stays there, when the new one is complete.

    Raises:
        ConfigError: the scene cannot be. InputError: `out` holds something else, or cannot be written.
        DependencyError: no OpenGL, or the extra ``sim`` is missing.
    """
    check_replaceable(out, command=_COMMAND, replace=replace)
    if processes is not None and processes < 1:
        raise InputError(f"processes: expected at least 1, got {processes}")
    live = live_scene(scene)
    job = _job(live, working_backend())
    unfinished = _unfinished(out, scene)
    try:
        with output_folder(
            out,
            command=_COMMAND,
            inputs=motion_files(scene),
            replace=replace,
            keep_unfinished=True,
            unfinished=unfinished,
        ) as made:
            paths = SessionPaths(made.folder)
            _begin(paths, scene)
            _render(live, job, paths, progress, processes or usable_cores())
            finish_session(live, paths)
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error}); simulate again to continue") from None
    return SessionPaths(Path(out))


def _unfinished(out: Path, scene: Scene) -> Path | None:
    """The staging folder of an interrupted run of the same scene; each of another scene is a `UserWarning`."""
    same = None
    for folder in find_unfinished(out):
        written = SessionPaths(folder).scene
        if written.is_file() and written.read_text(encoding="utf-8") == scene_text(scene):
            same = folder
        else:
            line = f"{folder}: is an unfinished session of another scene; delete it when it is not needed any more"
            warn_caller(line)
    return same


def _begin(paths: SessionPaths, scene: Scene) -> None:
    for folder in (paths.videos, paths.truth.parent, paths.parts):
        folder.mkdir(exist_ok=True)
    paths.scene.write_text(scene_text(scene), encoding="utf-8")


def _job(live: LiveScene, backend: str) -> RenderJob:
    model, still = render_model(live, live.rig, backend), dataclasses.replace(live, people=(), props=())
    return RenderJob(model=model, backend=backend, live=still, flesh_m=flesh_of_points(live))


def _render(live: LiveScene, job: RenderJob, paths: SessionPaths, progress: Progress, processes: int) -> None:
    runs = runs_of(live, paths)
    if not isinstance(live.scene.record, H264Settings):
        for name in live.rig.names:
            (paths.videos / name).mkdir(exist_ok=True)
    for camera in live.placed:
        if camera.sensor.depth:
            paths.depth(camera.name).mkdir(parents=True, exist_ok=True)
    total = sum(len(shots) for shots in live.shots)
    missing = [run for run in runs if not run.done.is_file()]
    done = total - sum(run.frames.stop - run.frames.start for run in missing)
    progress(done, total)
    tasks = ((run, *exposed(live, run.camera, run.frames)) for run in missing)
    for frames in render_all(job, tasks, min(processes, max(1, len(missing)))):
        done += frames
        progress(done, total)


class SessionPaths:
    """Where things are in a session folder.

    Attributes:
        folder: the session. rig: the exact cameras. videos: one video or image folder per camera. scene: every setting.
        truth: `core.Truth`. shots: true and stamped times of every frame.
        parts: finished runs of frames of an unfinished session.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, truth = folder, folder / "truth"
        self.rig, self.videos, self.scene, self.parts = (folder / name for name in ("rig.toml", "videos", SCENE_FILE, "parts"))
        self.truth, self.shots = (truth / f"{name}.npz" for name in ("truth", "shots"))

    def depth(self, camera: str) -> Path:
        """The depth images of a camera."""
        return self.folder / "depth" / camera

    def video(self, camera: str) -> Path:
        """The H.264 video of a camera."""
        return self.videos / f"{camera}.mp4"


# frames of one task: what is lost when a session is interrupted
_RUN = 30
_RUN_OF_PICTURES = 240


def runs_of(live: LiveScene, paths: SessionPaths) -> list[FrameRun]:
    """All frames of a session, in runs short enough to lose little with one."""
    runs = []
    for c, shots in enumerate(live.shots):
        pictures = len(moments_of(live.placed[c].sensor, live.rig.cameras[c].size_wh[1]))
        length = max(1, min(_RUN, _RUN_OF_PICTURES // pictures))
        for i, first in enumerate(range(0, len(shots), length)):
            name = f"{shots.camera}-{i:05d}"
            video = paths.parts / f"{name}.mp4" if isinstance(live.scene.record, H264Settings) else paths.videos / shots.camera
            frames, done = slice(first, min(first + length, len(shots))), paths.parts / f"{name}.npz"
            runs.append(FrameRun(c, frames, video, paths.depth(shots.camera), done))
    return runs


def join_videos(parts: Sequence[Path], path: Path) -> None:
    """Put videos of one encoding, one after the other in time, into one .mp4 without encoding again; keeps their times.

    Raises:
        InputError: a part cannot be read, or the file cannot be written.
    """
    try:
        with open_mp4(path, MP4_OPTIONS) as joined:
            stream = None
            for part in parts:
                with av.open(str(part)) as container:
                    source = container.streams.video[0]
                    if stream is None:
                        stream = joined.add_stream_from_template(source)
                        stream.time_base = TIME_BASE
                    for packet in container.demux(source):
                        if packet.dts is not None:
                            packet.stream = stream
                            joined.mux(packet)
    except (av.error.FFmpegError, OSError) as error:
        raise InputError(f"{path}: cannot be joined from {len(parts)} parts ({error})") from None


def finish_session(live: LiveScene, paths: SessionPaths) -> None:
    """Join the runs, write rig and truth, and remove the runs."""
    runs = runs_of(live, paths)
    visible: list[Array] = []
    times: dict[str, Array] = {}
    for c, shots in enumerate(live.shots):
        times |= {f"seq{c}": shots.seq, f"t{c}_ns": shots.t_ns, f"stamp{c}_ns": shots.stamp_ns}
        own = [run for run in runs if run.camera == c]
        visible.append(np.concatenate([read_arrays(run.done)["visible"] for run in own]))
        if isinstance(live.scene.record, H264Settings):
            join_videos([run.video for run in own], paths.video(shots.camera))
        else:
            stamps = ((image_name(t_ns), t_ns) for t_ns in shots.stamp_ns.tolist())
            write_frame_times(paths.videos / shots.camera, stamps)
    write_rig(paths.rig, live.rig)
    write_truth(paths.truth, truth_with(live, visible))
    write_arrays(paths.shots, times)
    shutil.rmtree(paths.parts)
