"""A recording and the videos that it was made from, on one timeline: any camera at any time as a small image."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from posefuse import core
from posefuse.core import Closing, PosefuseError, SourceError
from posefuse.core.arrays import Array
from posefuse.formats.kept_video import VIDEOS_FOLDER
from posefuse.outputs.drawing import image_tile, jpeg_of, view_tile
from posefuse.outputs.overview import best_time_step
from posefuse.pipeline.opening import source_config
from posefuse.pipeline.session import Input, Session, find_session
from posefuse.pipeline.solve import config_of
from posefuse.pipeline.writing import lies_in, nearby_session
from posefuse.realtime.video_keeping import read_counts
from posefuse.sources import Seeker, nearest

R = TypeVar("R", bound=core.Recording)


def session_with_videos(recording: core.Recording, path: Path, within: Path | None = None) -> Session | None:
    """The session that shows a recording, of `posefuse track` or live; None where there is none.

    Args:
        path: of the recording, or of its second solve.
        within: a folder that the session and its files must lie in; None: anywhere.
    """
    if not recording.is_live and not recording.provenance.get("second_solve"):
        return nearby_session(recording, path, within)
    # in the recording's own folder, or in one next to it; a second solve is a folder next to that of the recording
    folders = (path.parent, *sorted(place.parent for place in path.parent.glob(f"*/{VIDEOS_FOLDER}")))
    found = (_kept(recording, folder, within) for folder in folders if (folder / VIDEOS_FOLDER).is_dir())
    return next((session for session in found if session is not None), None)


def _kept(recording: core.Recording, folder: Path, within: Path | None) -> Session | None:
    """The videos in a folder, if they were kept while the recording was made; each with the offset to its time."""
    try:
        session = find_session(folder, config_of(recording.provenance))
    except PosefuseError:
        return None
    inputs = tuple(_in_time(recording, session))
    if len(inputs) < len(session.inputs) or not inputs or (within is not None and not lies_in(session, within)):
        return None
    return replace(session, inputs=inputs)


def _in_time(recording: core.Recording, session: Session) -> Iterator[Input]:
    """Cameras of the recording whose finished videos overlap with it, with the times of the recording."""
    start_ns, end_s = recording.provenance.get("start_ns"), int(recording.poses.t_ns[-1]) / 1e9
    for entry in session.inputs:
        [kept] = read_counts(entry.path.parent, [entry.path.stem]).values()
        complete = entry.kind == "videos" and kept.finished and kept.written and kept.zero_ns
        if not complete or not isinstance(start_ns, int) or entry.camera not in recording.rig.names:
            return
        offset_s = (kept.zero_ns - start_ns) / 1e9
        if offset_s + kept.first_s <= end_s and offset_s + kept.last_s >= 0:
            yield replace(entry, settings=replace(entry.settings, offset_s=offset_s, drift_ppm=0.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class PlaybackStep:
    """One camera at one time.

    Attributes:
        t_ns: session time of the frame shown. jpeg: the image, of size_wh px.
        detected_px, projected_px: (N, K, 2) what the detector found, and where the 3D result lies, in px of this image.
    """

    t_ns: int
    jpeg: bytes
    size_wh: tuple[int, int]
    detected_px: Array
    projected_px: Array


class Playback(Closing, Generic[R]):
    """The images of a recording; made by `Recording.playback`, a context manager. May be asked from several threads.

    Args:
        session: that it was made from, see `session_with_videos`; None: skeletons on plain ground.

    Attributes:
        recording: the result. problems: by camera, why there are no images of it.
    """

    def __init__(self, recording: R, session: Session | None) -> None:
        self.recording = recording
        self.problems: dict[str, str] = {}
        self._seekers = _opened(recording, session, self.problems) if session is not None else {}

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names in the order of the rig."""
        return self.recording.rig.names

    @property
    def has_images(self) -> bool:
        """Whether there are images of any camera."""
        return bool(self._seekers)

    @property
    def begin_ns(self) -> int:
        """The first time step at which all cameras with images have one; the recording's first where there is no such time."""
        t_ns = self.recording.poses.t_ns
        begins = [int(one.times_ns[0]) for one in self._seekers.values()]
        if not len(t_ns):
            return 0
        later = np.flatnonzero(t_ns >= max(begins, default=0))
        return int(t_ns[later[0] if len(later) else 0])

    def shown_wh(self, camera: int, width_px: int) -> tuple[int, int]:
        """Width and height of a small image of a camera of the rig, by its number."""
        return _tile_wh(self.recording.rig.cameras[camera].size_wh, width_px)

    def step_at(self, t_ns: int) -> int:
        """The time step nearest to a time."""
        return nearest(self.recording.poses.t_ns, t_ns)

    def at(self, camera: str, t_ns: int, width_px: int) -> PlaybackStep | None:
        """What a camera saw nearest to a time; None where it has no frame there.

        Args:
            camera: name in the rig. t_ns: session time. width_px: at most; images are never enlarged.
        """
        found = self._image(camera, t_ns)
        if found is None:
            return None
        shown_ns, image = found
        size_wh = (image.shape[1], image.shape[0])
        tile, scale = image_tile(image, size_wh, _tile_wh(size_wh, width_px))
        i, c = self.step_at(t_ns), self.cameras.index(camera)
        views, poses = self.recording.views, self.recording.poses
        detected = np.where((views.score[i, :, c] > 0)[..., None], views.xy_img[i, :, c], np.nan)
        projected = self.recording.rig.cameras[c].project(poses.xyz_world[i])
        # pixel centres are integers: the corner of the image is at -0.5
        detected_px, projected_px = ((xy + 0.5) * scale - 0.5 for xy in (detected, projected))
        return PlaybackStep(
            t_ns=shown_ns,
            jpeg=jpeg_of(tile),
            size_wh=(tile.shape[1], tile.shape[0]),
            detected_px=detected_px,
            projected_px=projected_px,
        )

    def tile_jpeg(self, camera: str, t_ns: int, width_px: int) -> bytes:
        """What a camera saw nearest to a time with skeletons and detections on top, on plain ground without a frame."""
        i, c = self.step_at(t_ns), self.cameras.index(camera)
        found = self._image(camera, t_ns)
        image = None if found is None else found[1]
        size_wh = self.recording.rig.cameras[c].size_wh if image is None else (image.shape[1], image.shape[0])
        return jpeg_of(view_tile(self.recording, i, c, image, _tile_wh(size_wh, width_px), notes=False))

    def best_tile_jpeg(self, width_px: int) -> bytes:
        """`tile_jpeg` at the time step at which most was measured, of the camera that saw most of it."""
        i = best_time_step(self.recording)
        seen = (self.recording.views.score[i] > 0).sum(axis=(0, 2))
        return self.tile_jpeg(self.cameras[int(np.argmax(seen))], int(self.recording.poses.t_ns[i]), width_px)

    def close(self) -> None:
        """Release the videos."""
        for seeker in self._seekers.values():
            seeker.close()

    def _image(self, camera: str, t_ns: int) -> tuple[int, Array] | None:
        """The frame nearest to a time, and its own; None where the camera has none within a period of it."""
        seeker = self._seekers.get(camera)
        if seeker is None:
            return None
        period_ns = float(np.median(np.diff(seeker.times_ns))) if len(seeker.times_ns) > 1 else np.inf
        try:
            frame = seeker.at(nearest(seeker.times_ns, t_ns))
        except SourceError:
            return None
        return (frame.t_ns, np.asarray(frame.image)) if abs(frame.t_ns - t_ns) <= period_ns else None


def _tile_wh(size_wh: tuple[int, int], width_px: int) -> tuple[int, int]:
    scale = min(1.0, width_px / size_wh[0])
    return round(size_wh[0] * scale), round(size_wh[1] * scale)


def _opened(recording: core.Recording, session: Session, problems: dict[str, str]) -> Mapping[str, Seeker]:
    config, seekers = config_of(recording.provenance), dict[str, Seeker]()
    for entry in session.inputs:
        if entry.camera not in recording.rig.names or entry.kind == "pose2d":
            continue
        try:
            seekers[entry.camera] = Seeker(source_config(entry, config, len(session.inputs)).build())
        except SourceError as error:
            problems[entry.camera] = str(error)
    return seekers
