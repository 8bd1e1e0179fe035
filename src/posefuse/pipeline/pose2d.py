"""Instants of folders with 2D poses that another tool has written: nothing to decode, everybody is in the files."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

from posefuse.core import Camera, Detections2D, InputError, Rig, Skeleton
from posefuse.core.errors import choices
from posefuse.formats.openpose import OpenPoseFolder, read_openpose_folder

from .config import CameraInput, TrackConfig
from .images import Instant, Timeline
from .session import Input, Session

DEFAULT_RATE_HZ = 30.0


class Pose2DInstants:
    """Instants of frame numbers first, first + 1, ... at an even rate; each camera gives its frame nearest to an instant.

    Args:
        folders: one per camera. timeline: the instants. first_number: the first instant's. settings: one per camera.
    """

    def __init__(
        self, folders: list[OpenPoseFolder], timeline: Timeline, first_number: int, settings: Sequence[CameraInput]
    ) -> None:
        self._folders, self._timeline = folders, timeline
        self._zero_ns = first_number * timeline.period_ns - timeline.start_ns
        self._clocks = [(round(one.offset_s * 1e9), timeline.period_ns * (1 + 1e-6 * one.drift_ppm)) for one in settings]

    @property
    def skeleton(self) -> Skeleton:
        """The files' keypoints."""
        return self._folders[0].skeleton

    @property
    def joint_centres(self) -> None:
        """Files do not say how joint centres lie beside their keypoints."""

    def __iter__(self) -> Iterator[Instant]:
        for i in range(self._timeline.count):
            t_ns = self._timeline.start_ns + i * self._timeline.period_ns
            yield Instant(t_ns, lambda pose, t_ns=t_ns: self._read(t_ns))  # type: ignore[misc]

    def close(self) -> None:
        """Nothing stays open."""

    def _read(self, t_ns: int) -> list[Detections2D]:
        seen = []
        for folder, (offset_ns, period_ns) in zip(self._folders, self._clocks, strict=True):
            number = round((t_ns + self._zero_ns - offset_ns) / period_ns)
            seen.append(folder.frame(number, round(number * period_ns) + offset_ns - self._zero_ns))
        return seen


def pose2d_instants(session: Session, config: TrackConfig) -> tuple[Rig, Pose2DInstants, Timeline]:
    """Instants of a session's 2D pose folders; frames of one number belong together.

    The rate is `config.rate_hz`, else the usual 30 Hz.

    Raises:
        InputError: folders of different skeletons, or no frame between start_s and end_s.
    """
    folders = [read_openpose_folder(entry.path, entry.camera) for entry in session.inputs]
    _check_one_skeleton(folders)
    rate_hz = config.rate_hz or DEFAULT_RATE_HZ
    period_ns = round(1e9 / rate_hz)
    first = min(folder.numbers[0] for folder in folders)
    last = max(folder.numbers[-1] for folder in folders)
    skip = 0 if config.start_s is None else max(0, -(-round(config.start_s * 1e9) // period_ns))
    count = last - first + 1 if config.end_s is None else min(last - first, round(config.end_s * rate_hz)) + 1
    if count - skip < 1:
        raise InputError(
            f"{session.folder}: no 2D pose from {config.start_s} to {config.end_s} s; "
            f"there are {last - first + 1} at {rate_hz:g} Hz"
        )
    timeline = Timeline(skip * period_ns, period_ns, count - skip)
    cameras = tuple(stated_camera(session.rig[entry.camera], entry) for entry in session.inputs)
    rig = dataclasses.replace(session.rig, cameras=cameras)
    return rig, Pose2DInstants(folders, timeline, first + skip, [entry.settings for entry in session.inputs]), timeline


def _check_one_skeleton(folders: list[OpenPoseFolder]) -> None:
    kinds: dict[Skeleton, str] = {folder.skeleton: folder.camera for folder in folders}
    if len(kinds) > 1:
        named = [f"{skeleton.name} (camera {camera})" for skeleton, camera in kinds.items()]
        raise InputError(f"2D pose folders: expected one skeleton for all cameras, got {choices(named)}")


def stated_camera(camera: Camera, entry: Input) -> Camera:
    """A stated cut-out moves the picture; the size of the pictures is not in these files."""
    crop = entry.settings.crop
    return camera.cropped(*crop, camera.size_wh) if crop else camera
