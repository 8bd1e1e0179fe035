"""Output ``rerun``: a recording for the Rerun viewer (extra `viewer`): cameras, images, skeletons, uncertainty, plots."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Le

from posefuse.core import Camera, DependencyError, Frame, Recording
from posefuse.core.arrays import Array
from posefuse.core.poses import point_sigma_m
from posefuse.foundation.output_file import atomic_file
from posefuse.foundation.settings import settings

from .drawing import DETECTION_RGB, jpeg_of, shrunk_wh
from .facts import provenance
from .frames import Frames, FrameSets, FrameSink, FrameWriter, ImageOutput, OneFileWriter, write_outputs
from .rerun_scene import (
    TIMELINE,
    camera_path,
    check_rerun,
    check_viewer,
    log_cameras,
    log_detections,
    log_name,
    log_person,
    log_projection,
    session_blueprint,
)

FILE = "recording.rrd"
_JPEG_QUALITY = 75


@settings
class RerunSink(ImageOutput):
    """``recording.rrd``, opens with ``rerun recording.rrd`` or ``posefuse view DIR``.

    Attributes:
        image_px: longer side of the stored images; 0 stores none.
    """

    image_px: Annotated[int, Ge(0), Le(8192)] = 640
    name: ClassVar[str] = "rerun"

    def build(self) -> FrameSink:
        """This output, ready; raises DependencyError without the Rerun SDK."""
        check_rerun()
        return self

    def writer(self, recording: Recording, folder: Path) -> FrameWriter:
        """Begin ``recording.rrd``; frames come one set at a time."""
        check_rerun()
        return _RerunWriter(recording, folder / FILE, self)


def open_in_viewer(path: Path) -> None:
    """Open an .rrd file in the Rerun viewer and wait until it is closed.

    Raises:
        DependencyError: the extra `viewer` is not installed, or there is no display to show it on.
    """
    check_viewer()
    ended = subprocess.run([sys.executable, "-m", "rerun", str(path)], check=False)
    if ended.returncode:
        raise DependencyError(f"the Rerun viewer ended with status {ended.returncode}; check it with: rerun rrd verify {path}")


def show_recording(recording: Recording, frame_sets: FrameSets | None = None) -> None:
    """Show a recording in the Rerun viewer until it is closed, with images where `frame_sets` has some.

    Raises:
        DependencyError: no Rerun SDK or no display; names the extra to install.
    """
    check_rerun()
    with tempfile.TemporaryDirectory(prefix="posefuse-") as folder:
        [path] = write_outputs([RerunSink()], recording, Path(folder), frame_sets)
        open_in_viewer(path)


class _RerunWriter(OneFileWriter):
    """Logs what never changes at once, plots as whole columns, and the rest step by step."""

    def __init__(self, recording: Recording, path: Path, config: RerunSink) -> None:
        import rerun as rr

        super().__init__(recording, path)
        self._config = config
        self._cameras = [_shown(camera, config.image_px) for camera in recording.rig]
        identity = f"{recording.rig.id}-{recording.poses.t_ns[0]}-{len(recording.poses)}"
        self._stream = rr.RecordingStream("posefuse", recording_id=identity)

    def __enter__(self) -> _RerunWriter:
        temporary = self._whole.enter_context(atomic_file(self._path))
        self._whole.callback(self._stream.disconnect)
        self._stream.save(temporary, default_blueprint=session_blueprint(self._recording.rig.names, _below()))
        log_cameras(self._stream, self._cameras)
        self._log_about()
        self._log_plots()
        return self

    def add(self, i: int, frames: Frames) -> None:
        poses = self._recording.poses
        self._stream.set_time(TIMELINE, duration=float(poses.t_ns[i]) / 1e9)
        for n, person in enumerate(poses.person_id):
            path = f"world/people/{person}"
            log_person(self._stream, path, poses.skeleton, poses.xyz_world[i, n], poses.cov_world[i, n])
            log_name(self._stream, path, self._recording.person_names[n], poses.xyz_world[i, n])
        for c, frame in enumerate(frames):
            self._log_view(i, c, frame)

    def _log_about(self) -> None:
        import rerun as rr

        about = json.dumps(provenance(self._recording), indent=2, default=str)
        self._stream.log("about", rr.TextDocument(f"```json\n{about}\n```", media_type="text/markdown"), static=True)

    def _log_plots(self) -> None:
        import rerun as rr

        poses = self._recording.poses
        times = rr.TimeColumn(TIMELINE, duration=poses.t_ns / 1e9)
        for n, person in enumerate(poses.person_id):
            series = {
                "reprojection_px": _mean_over_keypoints(poses.reproj_px[:, n]),
                "views": poses.n_views[:, n].mean(axis=1),
                "sigma_mm": _mean_over_keypoints(point_sigma_m(poses.cov_world[:, n])) * 1000,
            }
            for name, values in series.items():
                path = f"plots/{name}/person_{person}"
                self._stream.log(path, rr.SeriesLines(names=self._recording.person_names[n]), static=True)
                self._stream.send_columns(path, [times], rr.Scalars.columns(scalars=values))

    def _log_view(self, i: int, c: int, frame: Frame | None) -> None:
        import rerun as rr

        recording, camera = self._recording, self._cameras[c]
        if self._config.image_px:
            image = None if frame is None else _jpeg(frame.image, camera.size_wh)
            blank = rr.Clear(recursive=False) if image is None else rr.EncodedImage(contents=image, media_type="image/jpeg")
            self._stream.log(f"{camera_path(camera.name)}/image", blank)
        scale = np.array(camera.size_wh) / recording.rig.cameras[c].size_wh
        views = recording.views
        seen = views.score[i, :, c] > 0
        log_detections(self._stream, camera.name, views.xy_img[i, :, c][seen], DETECTION_RGB, scale)
        log_projection(self._stream, camera, recording.poses.skeleton, recording.poses.xyz_world[i])


def _below() -> list[Any]:
    """Plots and texts under the views."""
    import rerun.blueprint as rrb

    return [
        rrb.TimeSeriesView(origin="plots/reprojection_px", name="reprojection error, px"),
        rrb.TimeSeriesView(origin="plots/views", name="views per keypoint"),
        rrb.TimeSeriesView(origin="plots/sigma_mm", name="standard deviation, mm"),
        rrb.TextDocumentView(origin="about", name="about"),
    ]


def _shown(camera: Camera, longest_px: int) -> Camera:
    """The camera for the stored images, never enlarged."""
    return camera.scaled(shrunk_wh(camera.size_wh, longest_px)) if longest_px else camera


def _jpeg(image: Array, size_wh: tuple[int, int]) -> bytes:
    import cv2

    return jpeg_of(cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA), _JPEG_QUALITY)


def _mean_over_keypoints(values: Array) -> Array:
    """(T,) mean over what is there; NaN where nothing is."""
    there = np.isfinite(values)
    count = there.sum(axis=1)
    return np.where(count > 0, np.where(there, values, 0).sum(axis=1) / np.maximum(count, 1), np.nan)
