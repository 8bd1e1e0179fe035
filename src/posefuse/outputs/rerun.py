"""Output ``rerun``: a recording for the Rerun viewer (extra `viewer`): cameras, images, skeletons, uncertainty.

The first part is what every Rerun view shows alike, the live one too. Rerun puts pixel centres at halves, posefuse at integers:
every 2D position is moved by half a pixel here.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from posefuse.core import Camera, DependencyError, Frame, Recording, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.se3 import wxyz_from_matrix
from posefuse.foundation.output_file import atomic_file, check_space
from posefuse.foundation.platform import display
from posefuse.foundation.settings import settings

from .drawing import DETECTION_RGB, bone_colours, jpeg_of, keypoint_colours, shrunk, shrunk_wh
from .frames import Frames, FrameSets, ImageOutput, ShowStep, write_outputs

if TYPE_CHECKING:
    import rerun as rr

TIMELINE = "session"
SPAWN = "spawn"
CAMERAS = "world/cameras"
RGB = tuple[int, int, int]
_MEMORY = "512MiB"
# longer side of stored images
_IMAGE_PX = 640
_HALF_PX = 0.5
_IMAGE_PLANE_M, _BONE_M, _POINT_M = 0.5, 0.012, 0.02
# a name stands so high above the highest keypoint
_NAME_ABOVE_M = 0.15
_LINE_2D, _POINT_2D = -1.5, -1.5
_ELLIPSOID_SIGMAS = 3.0
# where the disk is full, Rerun 0.41 waits for its own writer without end: a file ends while there is room for what waits
_ROOM_BYTES = 64_000_000


def check_rerun() -> None:
    """Raise DependencyError when the Rerun SDK is not installed."""
    if importlib.util.find_spec("rerun") is None:
        raise DependencyError("the Rerun viewer is not installed: pip install 'posefuse[viewer]'")


def check_viewer() -> None:
    """Raise DependencyError without the Rerun SDK, or a display for its window."""
    check_rerun()
    if not display():
        raise DependencyError(
            "the Rerun viewer (extra posefuse[viewer]) needs a display and there is none: write the output `rerun` to a file and "
            "open it on another machine, or in a browser: rerun --web-viewer recording.rrd"
        )


def opened_stream(title: str, place: str, blueprint: Callable[[], rr.blueprint.Blueprint]) -> rr.RecordingStream:
    """A live stream into a viewer of its own (`place` is ``spawn``) or into the .rrd file `place`.

    Raises:
        DependencyError: the Rerun SDK is not installed, or there is no display for a viewer. InputError: the disk is nearly full.
    """
    check_rerun()
    import rerun as rr

    stream = rr.RecordingStream(title)
    if place != SPAWN:
        check_room(Path(place))
        stream.save(place, default_blueprint=blueprint())
        return stream
    check_viewer()
    stream.spawn(memory_limit=_MEMORY, default_blueprint=blueprint())
    return stream


def check_room(file: Path) -> None:
    """Raise InputError where the disk of an .rrd file that is being written is nearly full."""
    check_space(file.absolute().parent, _ROOM_BYTES)


def camera_path(name: str) -> str:
    """Where a camera's image and what is drawn into it are logged."""
    import rerun as rr

    return f"{CAMERAS}/{rr.escape_entity_path_part(name)}"


def log_cameras(stream: rr.RecordingStream, cameras: Sequence[Camera], rgb: RGB | None = None) -> None:
    """The world's axes and every camera at its place, for all of time."""
    import rerun as rr

    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for camera in cameras:
        pose, path = camera.cam_from_world.inverse(), camera_path(camera.name)
        stream.log(path, rr.Transform3D(translation=pose.xyz, mat3x3=pose.matrix()), static=True)
        stream.log(path, pinhole(camera, rgb), static=True)


def pinhole(camera: Camera, rgb: RGB | None = None) -> rr.Pinhole:
    """The intrinsics of a camera, its frustum in a colour."""
    import rerun as rr

    return rr.Pinhole(
        image_from_camera=camera.K,
        resolution=camera.size_wh,
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=_IMAGE_PLANE_M,
        color=rgb,
    )


def log_person(
    stream: rr.RecordingStream, path: str, skeleton: Skeleton, xyz_world: Array, cov_world: Array | None = None
) -> None:
    """Bones and keypoints (K, 3) of a person in 3D, and ellipsoids of three sigma where covariances (K, 3, 3) are given."""
    import rerun as rr

    bones = skeleton.bone_indices
    rgb, bone_rgb = np.array(keypoint_colours(skeleton), np.uint8), _bone_rgb(skeleton)
    here = np.asarray(np.isfinite(xyz_world).all(axis=-1))
    whole = here[bones].all(axis=1)
    names = [name for name, known in zip(skeleton.keypoints, here, strict=True) if known]
    points = rr.Points3D(xyz_world[here], colors=rgb[here], radii=_POINT_M, labels=names, show_labels=False)
    stream.log(f"{path}/bones", rr.LineStrips3D(xyz_world[bones[whole]], colors=bone_rgb[whole], radii=_BONE_M))
    stream.log(f"{path}/keypoints", points)
    if cov_world is not None:
        known = here & np.isfinite(cov_world).all(axis=(-1, -2))
        half, quaternion = ellipsoid_axes(cov_world[known])
        shown = rr.Ellipsoids3D(centers=xyz_world[known], half_sizes=half, quaternions=quaternion, colors=rgb[known])
        stream.log(f"{path}/uncertainty", shown)


def log_name(stream: rr.RecordingStream, path: str, name: str, xyz_world: Array) -> None:
    """A person's name above the highest of keypoints (K, 3)."""
    import rerun as rr

    known = xyz_world[np.isfinite(xyz_world).all(axis=-1)]
    place = known[known[:, 2].argmax()] + [0, 0, _NAME_ABOVE_M] if len(known) else np.zeros((0, 3))
    stream.log(f"{path}/name", rr.Points3D(place.reshape(-1, 3), labels=[name] * (len(known) > 0), radii=0.0, show_labels=True))


def log_projection(
    stream: rr.RecordingStream, camera: Camera, skeleton: Skeleton, xyz_world: Array, rgb: RGB | None = None
) -> None:
    """Bones of all people (N, K, 3) in a camera's image, in their own colours or all in one."""
    import rerun as rr

    strips: Array = camera.project(xyz_world)[:, skeleton.bone_indices] + _HALF_PX
    whole = np.isfinite(strips).all(axis=(-1, -2))
    colours = np.broadcast_to(_bone_rgb(skeleton), (*whole.shape, 3))[whole] if rgb is None else rgb
    stream.log(f"{camera_path(camera.name)}/skeleton", rr.LineStrips2D(strips[whole], colors=colours, radii=_LINE_2D))


def log_detections(stream: rr.RecordingStream, camera: str, xy_img: Array, rgb: RGB, scale: Array | float = 1.0) -> None:
    """Detected keypoints (n, 2) px in a camera's image, which is stored `scale` times as large."""
    import rerun as rr

    points = rr.Points2D((xy_img + _HALF_PX) * scale, colors=rgb, radii=_POINT_2D)
    stream.log(f"{camera_path(camera)}/detections", points)


def session_blueprint(names: Sequence[str], below: Sequence[Any] = ()) -> rr.blueprint.Blueprint:
    """3D on the left, all cameras on the right; `below`: at most one view below them."""
    import rerun.blueprint as rrb

    views = (rrb.Spatial2DView(origin=camera_path(name), contents=["$origin/**"], name=name) for name in names)
    above = rrb.Horizontal(rrb.Spatial3DView(origin="world", name="3D"), rrb.Grid(*views), column_shares=[3, 4])
    return rrb.Blueprint(rrb.Vertical(above, *below, row_shares=[3, 1][: 1 + len(below)]), collapse_panels=True)


def ellipsoid_axes(cov: Array) -> tuple[Array, Array]:
    """Half axes (n, 3) at three sigma and xyzw quaternions (n, 4) of covariances (n, 3, 3)."""
    values, vectors = np.linalg.eigh(cov)
    vectors = vectors * np.sign(np.linalg.det(vectors))[:, None, None]
    wxyz = wxyz_from_matrix(vectors)
    return _ELLIPSOID_SIGMAS * np.sqrt(values.clip(0)), wxyz[:, [1, 2, 3, 0]]


def _bone_rgb(skeleton: Skeleton) -> Array:
    return np.array(bone_colours(skeleton), np.uint8).reshape(-1, 3)


@settings
class RerunSink(ImageOutput):
    """``recording.rrd``, opens with ``rerun recording.rrd`` or ``posefuse view DIR``."""

    name: ClassVar[str] = "rerun"
    file: ClassVar[str] = "recording.rrd"

    def build(self) -> Self:
        """This output, ready; raises DependencyError without the Rerun SDK."""
        check_rerun()
        return self

    @contextmanager
    def showing(self, recording: Recording, path: Path) -> Iterator[ShowStep]:
        """What never changes is logged at once, and the rest step by step."""
        check_rerun()
        import rerun as rr

        identity = f"{recording.rig.id}-{recording.poses.t_ns[0]}-{len(recording.poses)}"
        stream = rr.RecordingStream("posefuse", recording_id=identity)
        with atomic_file(path) as staged:
            try:
                check_room(staged)
                stream.save(staged, default_blueprint=session_blueprint(recording.rig.names))
                yield _Logged(stream, recording, staged).step
            finally:
                stream.disconnect()


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


class _Logged:
    """A recording that is logged to a stream into a file."""

    def __init__(self, stream: rr.RecordingStream, recording: Recording, file: Path) -> None:
        self._stream, self._recording, self._file = stream, recording, file
        self._cameras = [camera.scaled(shrunk_wh(camera.size_wh, _IMAGE_PX)) for camera in recording.rig]
        log_cameras(stream, self._cameras)

    def step(self, i: int, frames: Frames) -> None:
        """One time step; raises InputError where the disk is nearly full."""
        check_room(self._file)
        poses = self._recording.poses
        self._stream.set_time(TIMELINE, duration=float(poses.t_ns[i]) / 1e9)
        for n, person in enumerate(poses.person_id):
            path = f"world/people/{person}"
            log_person(self._stream, path, poses.skeleton, poses.xyz_world[i, n], poses.cov_world[i, n])
            log_name(self._stream, path, self._recording.person_names[n], poses.xyz_world[i, n])
        for c, frame in enumerate(frames):
            self._log_view(i, c, frame)

    def _log_view(self, i: int, c: int, frame: Frame | None) -> None:
        import rerun as rr

        recording, camera = self._recording, self._cameras[c]
        image = None if frame is None else jpeg_of(shrunk(frame.image, _IMAGE_PX))
        shown = rr.Clear(recursive=False) if image is None else rr.EncodedImage(contents=image, media_type="image/jpeg")
        self._stream.log(f"{camera_path(camera.name)}/image", shown)
        scale = np.array(camera.size_wh) / recording.rig.cameras[c].size_wh
        views = recording.views
        seen = views.score[i, :, c] > 0
        log_detections(self._stream, camera.name, views.xy_img[i, :, c][seen], DETECTION_RGB, scale)
        log_projection(self._stream, camera, recording.poses.skeleton, recording.poses.xyz_world[i])
