"""Time steps of folders with 2D poses that another tool has written: nothing to decode, all people are in the files."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posefuse.core import (
    Camera,
    Detections2D,
    InputError,
    JointCentres,
    LookKind,
    Observations,
    Pose3D,
    Rig,
    Skeleton,
    SourceError,
)
from posefuse.core.errors import choices
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.formats.pose2d import Pose2DFrames, read_pose2d_of_cameras
from posefuse.sources import Coverage, incomplete_cameras

from .config import CameraInput, TrackConfig, read_project
from .images import Timeline, check_time_steps, frame_period_ns
from .session import Input, Session, data_entries

# Frame rate of 2D pose files: as set, as the project or the videos next to them state it; never assumed.

# rates that differ by less are one rate: files round what cameras deliver
_SAME_SHARE = 0.01


def pose2d_rate_hz(session: Session, config: TrackConfig) -> float:
    """Frames per second of a session's 2D poses.

    The first of these that is known: ``rate_hz`` of the config (``--rate``), the ``Config.toml`` of a Pose2Sim project, the
    videos in the session's folder.

    Raises:
        InputError: none of them is known, or two videos have different rates.
    """
    if config.rate_hz is not None:
        return config.rate_hz
    project = read_project(session.folder)
    if project is not None and project.frame_rate_hz is not None:
        return project.frame_rate_hz
    rates = dict(_video_rates(session.folder))
    if not rates:
        raise InputError(
            f"{session.folder}: the 2D poses do not state their frame rate, and no video lies next to them; add `rate_hz=HZ`, "
            f"or rate_hz = HZ to {session.folder / 'posefuse.toml'}"
        )
    if max(rates.values()) > min(rates.values()) * (1 + _SAME_SHARE):
        different = ", ".join(f"{name} {rate:g} Hz" for name, rate in rates.items())
        raise InputError(f"{session.folder}: expected one frame rate, got {different}; add `rate_hz=HZ`")
    return float(np.median(list(rates.values())))


def _video_rates(folder: Path) -> Iterator[tuple[str, float]]:
    """Name and frame rate of each video of the session that can be read."""
    from posefuse.sources import VideoConfig

    for path in data_entries(folder, "videos"):
        try:
            times = np.asarray(VideoConfig(path, path.stem).build().times_ns())
        except SourceError:
            continue
        if (period_ns := frame_period_ns(times)) is not None:
            yield path.name, 1e9 / period_ns


@dataclass(frozen=True)
class Pose2DStep:
    """One time step of 2D pose files; implements `TimeStep`.

    Attributes:
        t_ns: session clock. files: per camera its folder, the frame number there, and the time of that frame.
    """

    t_ns: int
    files: tuple[tuple[Pose2DFrames, int, int], ...]

    def look(self, kind: LookKind, expected: Pose3D | None) -> tuple[Detections2D, ...]:
        """All people in the files, regardless of who is expected."""
        return tuple(folder.frame(number, t_ns) for folder, number, t_ns in self.files)


class Pose2DTimeSteps:
    """Time steps of frame numbers first, first + 1, ... at an even rate; each camera gives its frame nearest to a time step.

    Args:
        folders: one per camera. timeline: the time steps. first_number: of the first. settings: one per camera.
    """

    def __init__(
        self, folders: list[Pose2DFrames], timeline: Timeline, first_number: int, settings: Sequence[CameraInput]
    ) -> None:
        self._folders, self._timeline = folders, timeline
        self._zero_ns = first_number * timeline.period_ns - timeline.start_ns
        self._clocks = [(round(one.offset_s * 1e9), timeline.period_ns * (1 + 1e-6 * one.drift_ppm)) for one in settings]

    @property
    def skeleton(self) -> Skeleton:
        """The files' keypoints."""
        return self._folders[0].skeleton

    @property
    def joint_centres(self) -> JointCentres | None:
        """Where joint centres lie relative to the keypoints of their set, where that is known."""
        return joint_centres_of_set(self.skeleton)

    def steps(self, stored: Observations | None = None) -> Iterator[Pose2DStep]:
        """The time steps after those of `stored`."""
        for i in range(0 if stored is None else len(stored.step_t_ns), self._timeline.count):
            t_ns = self._timeline.t_ns(i)
            clocks = zip(self._folders, self._clocks, strict=True)
            yield Pose2DStep(t_ns, tuple(self._file(folder, *clock, t_ns) for folder, clock in clocks))

    def close(self) -> None:
        """Nothing stays open."""

    def incomplete(self) -> list[str]:
        """One line for each camera whose files have gaps in their numbers, or end before the others'."""
        line = self._timeline
        first = round((line.start_ns + self._zero_ns) / line.period_ns)
        wanted = range(first, first + line.count)
        return incomplete_cameras([self._coverage(folder, wanted) for folder in self._folders])

    def _coverage(self, folder: Pose2DFrames, wanted: range) -> Coverage:
        there = [number for number in folder.numbers if number in wanted]
        expected = min(folder.numbers[-1], wanted[-1]) - max(folder.numbers[0], wanted[0]) + 1
        period_ns = self._timeline.period_ns
        end_ns = there[-1] * period_ns - self._zero_ns if there else None
        return Coverage(folder.camera, max(0, expected), len(there), end_ns, period_ns)

    def _file(self, folder: Pose2DFrames, offset_ns: int, period_ns: float, t_ns: int) -> tuple[Pose2DFrames, int, int]:
        number = round((t_ns + self._zero_ns - offset_ns) / period_ns)
        return folder, number, round(number * period_ns) + offset_ns - self._zero_ns


def pose2d_time_steps(session: Session, config: TrackConfig) -> tuple[Rig, Pose2DTimeSteps, Timeline]:
    """Time steps of a session's 2D pose folders; frames of one number belong together.

    The rate is that of `pose2d_rate_hz`.

    Raises:
        InputError: folders of different skeletons, no frame between start_s and end_s, or a frame rate that is not known.
    """
    folders = read_session_poses(session, config.keypoints)
    _check_one_skeleton(folders)
    rate_hz = pose2d_rate_hz(session, config)
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
    numbered = f"{session.folder}: 2D poses with frame numbers {first} to {last}"
    check_time_steps(count - skip, rate_hz, numbered)
    timeline = Timeline(skip * period_ns, period_ns, count - skip)
    cameras = tuple(stated_camera(session.rig[entry.camera], entry) for entry in session.inputs)
    rig = dataclasses.replace(session.rig, cameras=cameras)
    return rig, Pose2DTimeSteps(folders, timeline, first + skip, [entry.settings for entry in session.inputs]), timeline


def read_session_poses(session: Session, keypoints: str) -> list[Pose2DFrames]:
    """2D poses of all cameras of a session, see `read_pose2d_of_cameras`."""
    paths = {entry.camera: entry.path for entry in session.inputs}
    return read_pose2d_of_cameras(paths, keypoints)


def joint_centres_of_set(skeleton: Skeleton) -> JointCentres | None:
    """Joint centres for files that name no network: MediaPipe's keypoints are of the networks that come with us."""
    from posefuse.detection import default_cards

    if skeleton.name == "blazepose33":
        file = default_cards()[-1].joint_centres_file
        return read_joint_centres(file) if file else None
    return None


def _check_one_skeleton(folders: list[Pose2DFrames]) -> None:
    kinds: dict[Skeleton, str] = {folder.skeleton: folder.camera for folder in folders}
    if len(kinds) > 1:
        named = [f"{skeleton.name} (camera {camera})" for skeleton, camera in kinds.items()]
        raise InputError(f"2D pose folders: expected one skeleton for all cameras, got {choices(named)}")


def stated_camera(camera: Camera, entry: Input) -> Camera:
    """A stated crop moves the image; the size of the images is not in these files."""
    crop = entry.settings.crop
    return camera.cropped(*crop, camera.size_wh) if crop else camera
