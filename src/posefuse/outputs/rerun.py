"""Output ``rerun``: a recording for the Rerun viewer (extra `viewer`): cameras, images, skeletons, uncertainty, plots."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from annotated_types import Ge, Le

from posefuse.core import Camera, DependencyError, Frame, Recording
from posefuse.core.arrays import Array
from posefuse.formats.recording import read_recording
from posefuse.foundation.atomic import atomic_file
from posefuse.foundation.settings import settings

from .drawing import DETECTION_RGB, bone_colours, keypoint_colours
from .facts import provenance, sigma_m
from .frames import Frames, FrameSets, FrameSink, FrameWriter, write_outputs, write_without_frames

if TYPE_CHECKING:
    import rerun as rr

FILE = "recording.rrd"
TIMELINE = "session"
SPAWN = "spawn"
_MEMORY = "512MiB"
_ELLIPSOID_SIGMAS = 3.0
_IMAGE_PLANE_M = 0.5


@settings
class RerunSink:
    """``recording.rrd``, opens with ``rerun recording.rrd`` or ``posefuse view DIR``.

    Attributes:
        image_px: longer side of the stored images; 0 stores none.
        jpeg_quality: of the stored images.
    """

    image_px: Annotated[int, Ge(0), Le(8192)] = 640
    jpeg_quality: Annotated[int, Ge(1), Le(100)] = 75
    name: ClassVar[str] = "rerun"

    def build(self) -> FrameSink:
        """This output, ready; raises DependencyError without the Rerun SDK."""
        check_rerun()
        return self

    def write(self, recording: Recording, folder: Path) -> list[Path]:
        """Write ``recording.rrd`` without images; returns the file made."""
        return write_without_frames(self, recording, folder)

    def writer(self, recording: Recording, folder: Path) -> FrameWriter:
        """Begin ``recording.rrd``; frames come one set at a time."""
        check_rerun()
        return _RerunWriter(recording, folder / FILE, self)


def check_rerun() -> None:
    """Raise DependencyError when the Rerun SDK is not installed."""
    if importlib.util.find_spec("rerun") is None:
        raise DependencyError("the Rerun viewer is not installed: pip install 'posefuse[viewer]'")


def open_in_viewer(path: Path) -> None:
    """Open an .rrd file in the Rerun viewer and wait until it is closed.

    Raises:
        DependencyError: the extra `viewer` is not installed, or there is no display to show it on.
    """
    check_rerun()
    if not _has_display():
        raise DependencyError(
            "the Rerun viewer (extra posefuse[viewer]) needs a display and there is none: write the output `rerun` "
            f"(--outputs rerun) and open {FILE} on another machine, or in a browser: rerun --web-viewer {FILE}"
        )
    ended = subprocess.run([sys.executable, "-m", "rerun", str(path)], check=False)
    if ended.returncode:
        raise DependencyError(f"the Rerun viewer ended with status {ended.returncode}; check it with: rerun rrd verify {path}")


def opened_stream(title: str, place: str, blueprint: rr.blueprint.Blueprint) -> rr.RecordingStream:
    """A live stream into a viewer of its own (`place` is ``spawn``) or into the .rrd file `place`.

    Raises:
        DependencyError: there is no display for a viewer.
    """
    import rerun as rr

    stream = rr.RecordingStream(title)
    if place != SPAWN:
        stream.save(place, default_blueprint=blueprint)
        return stream
    if not _has_display():
        raise DependencyError("--view needs a display and there is none: use --view-file FILE.rrd and open it elsewhere")
    stream.spawn(memory_limit=_MEMORY, default_blueprint=blueprint)
    return stream


def _has_display() -> bool:
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def view_recording(
    folder: Path | str,
    read: Callable[[Path], Recording] = read_recording,
    frame_sets: FrameSets | None = None,
    open_viewer: Callable[[Path], None] = open_in_viewer,
) -> Path:
    """Show a result in the Rerun viewer until it is closed: its ``recording.rrd``, or one made for the occasion.

    Args:
        folder: a result that `read` reads: a folder, see `formats.recording`, or a file.
        frame_sets: images for a result that has no ``recording.rrd``.
        open_viewer: shows an .rrd file.

    Returns:
        What was shown: the ``recording.rrd``, or the folder of a result without one.

    Raises:
        DependencyError: no Rerun SDK or no display; names the extra to install.
        InputError: not a result folder.
    """
    check_rerun()
    folder = Path(folder)
    recording = read(folder)
    if (folder / FILE).is_file():
        open_viewer(folder / FILE)
        return folder / FILE
    with tempfile.TemporaryDirectory(prefix="posefuse-") as beside:
        [path] = write_outputs([RerunSink()], recording, Path(beside), frame_sets)
        open_viewer(path)
    return folder


class _RerunWriter:
    """Logs what never changes at once, plots as whole columns, and the rest instant by instant."""

    def __init__(self, recording: Recording, path: Path, config: RerunSink) -> None:
        import rerun as rr

        self._recording, self._path, self._config = recording, path, config
        self._whole = ExitStack()
        self._cameras = [_shown(camera, config.image_px) for camera in recording.rig]
        skeleton = recording.poses.skeleton
        self._bones, self._bone_rgb, self._keypoint_rgb = (
            skeleton.bone_indices,
            bone_colours(skeleton),
            keypoint_colours(skeleton),
        )
        identity = f"{recording.rig.id}-{recording.poses.t_ns[0]}-{len(recording.poses)}"
        self._stream = rr.RecordingStream("posefuse", recording_id=identity)

    def __enter__(self) -> _RerunWriter:
        beside = self._whole.enter_context(atomic_file(self._path))
        self._stream.save(beside, default_blueprint=_blueprint(self._recording))
        self._log_static()
        self._log_plots()
        return self

    def __exit__(self, *problem: Any) -> None:
        self._stream.disconnect()
        self._whole.__exit__(*problem)

    @property
    def files(self) -> list[Path]:
        return [self._path]

    def add(self, i: int, frames: Frames) -> None:
        self._stream.set_time(TIMELINE, duration=float(self._recording.poses.t_ns[i]) / 1e9)
        for n, person in enumerate(self._recording.poses.person_id):
            self._log_person(f"world/people/{person}", i, n)
        for c, frame in enumerate(frames):
            self._log_view(i, c, frame)

    def _log_static(self) -> None:
        import rerun as rr

        log = self._stream.log
        log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        about = json.dumps(provenance(self._recording), indent=2, default=str)
        log("about", rr.TextDocument(f"```json\n{about}\n```", media_type="text/markdown"), static=True)
        for camera in self._cameras:
            pose = camera.cam_from_world.inverse()
            path = _camera_path(camera)
            log(path, rr.Transform3D(translation=pose.xyz, mat3x3=pose.matrix()), static=True)
            log(
                path,
                rr.Pinhole(
                    image_from_camera=camera.K,
                    resolution=camera.size_wh,
                    camera_xyz=rr.ViewCoordinates.RDF,
                    image_plane_distance=_IMAGE_PLANE_M,
                ),
                static=True,
            )

    def _log_plots(self) -> None:
        import rerun as rr

        poses = self._recording.poses
        times = rr.TimeColumn(TIMELINE, duration=poses.t_ns / 1e9)
        for n, person in enumerate(poses.person_id):
            series = {
                "reprojection_px": _mean_over_keypoints(poses.reproj_px[:, n]),
                "views": poses.n_views[:, n].mean(axis=1),
                "sigma_mm": _mean_over_keypoints(sigma_m(poses)[:, n]) * 1000,
            }
            for name, values in series.items():
                path = f"plots/{name}/person_{person}"
                self._stream.log(path, rr.SeriesLines(names=f"person {person}"), static=True)
                self._stream.send_columns(path, [times], rr.Scalars.columns(scalars=values))

    def _log_person(self, path: str, i: int, n: int) -> None:
        import rerun as rr

        poses = self._recording.poses
        xyz, cov = poses.xyz_world[i, n], poses.cov_world[i, n]
        here = np.isfinite(xyz).all(axis=-1)
        whole = here[self._bones].all(axis=1)
        rgb, bone_rgb = np.array(self._keypoint_rgb, np.uint8), np.array(self._bone_rgb, np.uint8).reshape(-1, 3)
        names = [name for name, ok in zip(poses.skeleton.keypoints, here, strict=True) if ok]
        log = self._stream.log
        log(f"{path}/bones", rr.LineStrips3D(xyz[self._bones[whole]], colors=bone_rgb[whole], radii=0.012))
        log(f"{path}/keypoints", rr.Points3D(xyz[here], colors=rgb[here], radii=0.02, labels=names, show_labels=False))
        known = here & np.isfinite(cov).all(axis=(-1, -2))
        half, quaternion = _ellipsoids(cov[known])
        ellipsoids = rr.Ellipsoids3D(centers=xyz[known], half_sizes=half, quaternions=quaternion, colors=rgb[known])
        log(f"{path}/uncertainty", ellipsoids)

    def _log_view(self, i: int, c: int, frame: Frame | None) -> None:
        import rerun as rr

        recording, camera = self._recording, self._cameras[c]
        path, log = _camera_path(camera), self._stream.log
        if self._config.image_px:
            image = None if frame is None else _jpeg(frame.image, camera.size_wh, self._config.jpeg_quality)
            blank = rr.Clear(recursive=False) if image is None else rr.EncodedImage(contents=image, media_type="image/jpeg")
            log(f"{path}/image", blank)
        scale = np.array(camera.size_wh) / recording.rig.cameras[c].size_wh
        seen = recording.views.score[i, :, c] > 0
        # pixel centres are integers here and halves in Rerun
        log(
            f"{path}/detections",
            rr.Points2D((recording.views.xy_img[i, :, c][seen] + 0.5) * scale, colors=DETECTION_RGB, radii=-1.5),
        )
        xy = camera.project(recording.poses.xyz_world[i]) + 0.5
        strips = xy[:, self._bones]
        whole = np.isfinite(strips).all(axis=(-1, -2))
        colours = np.broadcast_to(np.array(self._bone_rgb, np.uint8).reshape(-1, 3), (*whole.shape, 3))
        log(f"{path}/skeleton", rr.LineStrips2D(strips[whole], colors=colours[whole], radii=-1.5))


def _camera_path(camera: Camera) -> str:
    import rerun as rr

    return f"world/cameras/{rr.escape_entity_path_part(camera.name)}"


def _blueprint(recording: Recording) -> rr.blueprint.Blueprint:
    """3D on the left, all views beside it, plots below: what one wants to see first."""
    import rerun.blueprint as rrb

    views = [
        rrb.Spatial2DView(origin=_camera_path(camera), contents=["$origin/**"], name=camera.name) for camera in recording.rig
    ]
    plots = [
        rrb.TimeSeriesView(origin="plots/reprojection_px", name="reprojection error, px"),
        rrb.TimeSeriesView(origin="plots/views", name="views per keypoint"),
        rrb.TimeSeriesView(origin="plots/sigma_mm", name="standard deviation, mm"),
    ]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(rrb.Spatial3DView(origin="world", name="3D"), rrb.Grid(*views), column_shares=[3, 4]),
            rrb.Horizontal(*plots, rrb.TextDocumentView(origin="about", name="about")),
            row_shares=[3, 1],
        ),
        collapse_panels=True,
    )


def _shown(camera: Camera, longest_px: int) -> Camera:
    """The camera for the stored images, never enlarged."""
    factor = min(1.0, longest_px / max(camera.size_wh)) if longest_px else 1.0
    return camera.scaled((max(1, round(camera.size_wh[0] * factor)), max(1, round(camera.size_wh[1] * factor))))


def _jpeg(image: Array, size_wh: tuple[int, int], quality: int) -> bytes:
    import cv2

    small = cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA)
    _, encoded = cv2.imencode(".jpg", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return encoded.tobytes()


def _ellipsoids(cov: Array) -> tuple[Array, Array]:
    """Half axes (n, 3) at three sigma and xyzw quaternions (n, 4) of covariances (n, 3, 3)."""
    from posefuse.core.se3 import wxyz_from_matrix

    values, vectors = np.linalg.eigh(cov)
    vectors = vectors * np.sign(np.linalg.det(vectors))[:, None, None]
    wxyz = wxyz_from_matrix(vectors)
    return _ELLIPSOID_SIGMAS * np.sqrt(values.clip(0)), wxyz[:, [1, 2, 3, 0]]


def _mean_over_keypoints(values: Array) -> Array:
    """(T,) mean over what is there; NaN where nothing is."""
    there = np.isfinite(values)
    count = there.sum(axis=1)
    return np.where(count > 0, np.where(there, values, 0).sum(axis=1) / np.maximum(count, 1), np.nan)
