"""Runs of rendered frames of a session, and its files once all are rendered."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posefuse.core.arrays import Array
from posefuse.formats.frame_times import write_frame_times
from posefuse.formats.npz import read_arrays
from posefuse.formats.rig import write_rig
from posefuse.formats.truth import write_arrays, write_truth
from posefuse.formats.video import join_videos

from .build import LiveScene
from .exact import prop_truth, truth_with
from .render.shot import moments_of
from .render.workers import image_name
from .scene import H264Settings
from .session_folder import SessionPaths

# frames of one task: what is lost when a session is interrupted
_RUN = 30
_RUN_OF_PICTURES = 240


@dataclass(frozen=True)
class FrameRun:
    """Frames `frames` of camera number `camera`, stored as `video` and `done`."""

    camera: int
    frames: slice
    video: Path
    done: Path


def runs_of(live: LiveScene, paths: SessionPaths) -> list[FrameRun]:
    """All frames of a session, in runs short enough to lose little with one."""
    runs = []
    for c, shots in enumerate(live.shots):
        pictures = len(moments_of(live.placed[c].sensor, live.rig.cameras[c].size_wh[1]))
        length = max(1, min(_RUN, _RUN_OF_PICTURES // pictures))
        for i, first in enumerate(range(0, len(shots), length)):
            name = f"{shots.camera}-{i:05d}"
            video = paths.parts / f"{name}.mp4" if isinstance(live.scene.record, H264Settings) else paths.videos / shots.camera
            runs.append(FrameRun(c, slice(first, min(first + length, len(shots))), video, paths.parts / f"{name}.npz"))
    return runs


def finish_session(live: LiveScene, paths: SessionPaths) -> None:
    """Join the runs, write rig and truth, and remove the runs."""
    runs = runs_of(live, paths)
    visible = []
    for c, shots in enumerate(live.shots):
        own = [run for run in runs if run.camera == c]
        visible.append(np.concatenate([read_arrays(run.done)["visible"] for run in own]))
        if isinstance(live.scene.record, H264Settings):
            join_videos([run.video for run in own], paths.video(shots.camera))
        else:
            times = shots.stamp_ns.tolist()
            write_frame_times(paths.videos / shots.camera, ((image_name(t_ns), t_ns) for t_ns in times))
    write_rig(paths.rig, live.rig)
    write_truth(paths.truth, truth_with(live, visible))
    write_arrays(paths.shots, shot_arrays(live))
    if live.props:
        write_arrays(paths.props, prop_truth(live, visible))
    shutil.rmtree(paths.parts)


def cameras_with_depth(live: LiveScene) -> list[str]:
    """Names of the cameras that measure depth."""
    return [camera.name for camera in live.placed if camera.sensor.depth is not None]


def shot_arrays(live: LiveScene) -> dict[str, Array]:
    """Per camera number i: ``seq<i>``, ``t<i>_ns`` true mid-exposure, ``stamp<i>_ns`` the stamp in its video."""
    arrays: dict[str, Array] = {}
    for i, shots in enumerate(live.shots):
        arrays |= {f"seq{i}": shots.seq, f"t{i}_ns": shots.t_ns, f"stamp{i}_ns": shots.stamp_ns}
    return arrays
