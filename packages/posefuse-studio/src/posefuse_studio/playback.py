"""A recording and the videos that it was made from, on one timeline: any moment of any camera as a small image."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posefuse.core import Closing, PosefuseError, Recording, SourceError
from posefuse.core.arrays import Array
from posefuse.formats.kept_video import VIDEOS_FOLDER
from posefuse.foundation.platform import usable_cores
from posefuse.outputs.drawing import image_tile, jpeg_of, view_tile
from posefuse.outputs.overview import best_time_step, stage_picture
from posefuse.pipeline.catalogue import cache_place, keep_cached
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.reading import read_result
from posefuse.pipeline.session import Input, Session, find_session
from posefuse.pipeline.solve import config_of
from posefuse.pipeline.writing import lies_in, nearby_session
from posefuse.sources import ImagesConfig, ImagesSeeker, Seeker, VideoConfig, VideoSeeker, nearest

# The videos that were kept during a live session, on the time of its recording.


def session_with_videos(recording: Recording, path: Path, within: Path | None = None) -> Session | None:
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


def _kept(recording: Recording, folder: Path, within: Path | None) -> Session | None:
    """The videos in a folder, if they were kept while the recording was made; each with the offset to its time."""
    try:
        session = find_session(folder, config_of(recording.provenance))
    except PosefuseError:
        return None
    inputs = tuple(_in_time(recording, session))
    if len(inputs) < len(session.inputs) or not inputs or (within is not None and not lies_in(session, within)):
        return None
    return replace(session, inputs=inputs)


def _in_time(recording: Recording, session: Session) -> Iterator[Input]:
    """Cameras of the recording whose videos overlap with it, with the times of the recording."""
    start_ns, end_ns = recording.provenance.get("start_ns"), int(recording.poses.t_ns[-1])
    for entry in session.inputs:
        kept = read_kept_times(entry.path) if entry.kind == "videos" else None
        if kept is None or not isinstance(start_ns, int) or entry.camera not in recording.rig.names:
            return
        offset_ns = kept.zero_ns - start_ns
        if offset_ns + kept.first_ns <= end_ns and offset_ns + kept.last_ns >= 0:
            yield replace(entry, settings=replace(entry.settings, offset_s=offset_ns / 1e9, drift_ppm=0.0))


@dataclass(frozen=True, kw_only=True)
class KeptTimes:
    """Attributes:
    zero_ns: time 0 of the video on the session's clock. first_ns, last_ns: its first and last frame, from there.
    """

    zero_ns: int
    first_ns: int
    last_ns: int


def read_kept_times(video: Path) -> KeptTimes | None:
    """When a video was kept, from the ``CAMERA.json`` next to it; None where that is missing, or the video was not finished."""
    try:
        content = json.loads(video.with_suffix(".json").read_text(encoding="utf-8"))
        if not (content["finished"] and content["written"] and content["zero_ns"]):
            return None
        first_ns, last_ns = (round(1e9 * float(content[name])) for name in ("first_s", "last_s"))
        return KeptTimes(zero_ns=int(content["zero_ns"]), first_ns=first_ns, last_ns=last_ns)
    except (OSError, ValueError, TypeError, KeyError, OverflowError):
        return None


JPEG_QUALITY = 75


@dataclass(frozen=True, eq=False, kw_only=True)
class PlaybackStep:
    """One camera at one moment.

    Attributes:
        t_ns: session time of the frame shown. jpeg: the image, of size_wh px.
        detected_px, projected_px: (N, K, 2) what the detector found, and where the 3D result lies, in px of this image.
    """

    t_ns: int
    jpeg: bytes
    size_wh: tuple[int, int]
    detected_px: Array
    projected_px: Array


class Playback(Closing):
    """The moments of a recording; a context manager. May be asked from several threads.

    Args:
        recording: a result. session: that it was made from, see `session_images`; None: skeletons on plain ground.

    Attributes:
        problems: by camera, why there are no images of it.
    """

    def __init__(self, recording: Recording, session: Session | None) -> None:
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
        begins = [int(one.times_ns[0]) for one in self._seekers.values() if len(one.times_ns)]
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

    def moment(self, camera: str, t_ns: int, width_px: int, *, quality: int = JPEG_QUALITY) -> PlaybackStep | None:
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
            jpeg=jpeg_of(tile, quality),
            size_wh=(tile.shape[1], tile.shape[0]),
            detected_px=detected_px,
            projected_px=projected_px,
        )

    def tile_jpeg(self, camera: str, t_ns: int, width_px: int, *, quality: int = JPEG_QUALITY) -> bytes:
        """What a camera saw nearest to a time with skeletons and detections on top, on plain ground without a frame."""
        i, c = self.step_at(t_ns), self.cameras.index(camera)
        found = self._image(camera, t_ns)
        image = None if found is None else found[1]
        size_wh = self.recording.rig.cameras[c].size_wh if image is None else (image.shape[1], image.shape[0])
        return jpeg_of(view_tile(self.recording, i, c, image, _tile_wh(size_wh, width_px), notes=False), quality)

    def close(self) -> None:
        """Release the videos."""
        for seeker in self._seekers.values():
            seeker.close()

    def _image(self, camera: str, t_ns: int) -> tuple[int, Array] | None:
        """The frame nearest to a time, and its own; None where the camera has none within a period of it."""
        seeker = self._seekers.get(camera)
        if seeker is None or not len(seeker.times_ns):
            return None
        i = nearest(seeker.times_ns, t_ns)
        period_ns = float(np.median(np.diff(seeker.times_ns))) if len(seeker.times_ns) > 1 else np.inf
        if abs(int(seeker.times_ns[i]) - t_ns) > period_ns:
            return None
        try:
            return int(seeker.times_ns[i]), np.asarray(seeker.at(i).image)
        except SourceError:
            return None


def _tile_wh(size_wh: tuple[int, int], width_px: int) -> tuple[int, int]:
    scale = min(1.0, width_px / size_wh[0])
    return round(size_wh[0] * scale), round(size_wh[1] * scale)


def _opened(recording: Recording, session: Session, problems: dict[str, str]) -> Mapping[str, Seeker]:
    config, seekers = config_of(recording.provenance), {}
    # cameras are decoded side by side: threads of their own help only where there are more cores than cameras
    threads = usable_cores() > len(session.inputs)
    for entry in session.inputs:
        if entry.camera not in recording.rig.names or entry.kind == "pose2d":
            continue
        try:
            seekers[entry.camera] = _seeker(entry, config, threads=threads)
        except SourceError as error:
            problems[entry.camera] = str(error)
    return seekers


def _seeker(entry: Input, config: TrackConfig, *, threads: bool) -> Seeker:
    offset_s, drift_ppm = entry.settings.offset_s, entry.settings.drift_ppm
    if entry.kind == "videos":
        return VideoSeeker(VideoConfig(entry.path, entry.camera, offset_s, drift_ppm, threads=threads))
    return ImagesSeeker(ImagesConfig(entry.path, entry.camera, config.rate_hz, offset_s, drift_ppm).build())


# A small image of a recording, for lists; kept in the cache folder, as figures of it are.

_PICTURE_WH = (320, 180)
_SMALL_QUALITY = 82


def thumbnail(path: Path, within: Path | None = None) -> bytes:
    """A small JPEG of a recording: its best seen view with the skeleton on top, from the cache where there is one.

    Args:
        within: a folder that its videos must lie in; None: anywhere.

    Raises:
        PosefuseError: the recording cannot be read.
    """
    place = cache_place(path, "jpg")
    if place.is_file():
        return place.read_bytes()
    made = _picture(path, within)
    keep_cached(place, made)
    return made


def _picture(path: Path, within: Path | None) -> bytes:
    recording = read_result(path, lambda line: None)
    i = best_time_step(recording)
    session = session_with_videos(recording, path, within)
    if session is None:
        return jpeg_of(stage_picture(recording, i, _PICTURE_WH), _SMALL_QUALITY)
    seen = (recording.views.score[i] > 0).sum(axis=(0, 2))
    camera = recording.rig.names[int(np.argmax(seen))]
    with Playback(recording, session) as playback:
        return playback.tile_jpeg(camera, int(recording.poses.t_ns[i]), _PICTURE_WH[0], quality=_SMALL_QUALITY)
