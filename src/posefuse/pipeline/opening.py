"""A session made ready for tracking: sources and detector opened, or what another tool detected read; the time steps known."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from posefuse.core import (
    DetectionBatch,
    Detections2D,
    InputError,
    JointCentres,
    LookKind,
    Observations,
    Rig,
    Skeleton,
    SourceError,
)
from posefuse.core.errors import choices, warn_caller
from posefuse.detection import default_cards
from posefuse.detection.build import build_detector
from posefuse.formats.image_folders import TIMES_FILE
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.formats.pose2d import Pose2DFrames, read_pose2d_of_cameras
from posefuse.foundation.platform import usable_cores
from posefuse.sources import Coverage, DepthSource, ImagesConfig, RecordedSource, VideoConfig, incomplete_cameras

from .config import CONFIG_FILE, CameraInput, TrackConfig
from .session import LEAST_CAMERAS, Input, Session, data_entries, fitted_camera, least_cameras
from .time_steps import ImageTimeSteps, Timeline, TimeStep, check_time_steps, common_timeline, frame_period_ns, stored_steps

# rates that differ by less are one rate: files round what cameras deliver
_SAME_SHARE = 0.01
# time steps of 2D poses that are packed together: an hour of single answers fills the memory
_PART_STEPS = 300


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Opened:
    """A session that can be tracked; to be closed.

    Attributes:
        session, config: as given. rig: the cameras as they apply to the images. timeline: the times of its time steps.
        skeleton: of all detections. joint_centres: where they lie relative to its keypoints; None where that is not known.
        images: videos or images with the detector that looks at them; None for 2D poses.
        stated: 2D poses that another tool has detected; None for images. gaps: one line for each camera that lacks some.
        sources: of images. network: what looks at images, and what is not known of it, by name; empty for 2D poses.
    """

    session: Session
    config: TrackConfig
    rig: Rig
    timeline: Timeline
    skeleton: Skeleton
    joint_centres: JointCentres | None
    images: ImageTimeSteps | None = None
    stated: Observations | None = None
    gaps: Sequence[str] = ()
    sources: tuple[RecordedSource, ...] = ()
    network: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def steps(self, stored: Observations | None = None) -> Iterator[TimeStep]:
        """The time steps after those of `stored`; may be called once."""
        if self.images is not None:
            return self.images.steps(stored)
        assert self.stated is not None
        return stored_steps(self.stated, 0 if stored is None else len(stored.step_t_ns))

    def incomplete(self) -> Sequence[str]:
        """One line for each camera of which part cannot be read, or that ends before the others; after all steps."""
        return self.gaps if self.images is None else self.images.incomplete()

    def close(self) -> None:
        """Stop decoding and release files."""
        if self.images is not None:
            self.images.close()


def open_session(session: Session, config: TrackConfig) -> Opened:
    """Open the data of all cameras and build the detector; a camera that cannot be read is a `UserWarning`.

    Raises:
        PosefuseError: several kinds of data, fewer than two cameras that can be read, nothing recorded in the time asked for.
    """
    return _poses(session, config) if session.kind == "pose2d" else _images(session, config)


def _images(session: Session, config: TrackConfig) -> Opened:
    _check_rate(session, config)
    sources, cameras, failed = [], [], dict[str, str]()
    for entry in session.inputs:
        try:
            source = build_source(entry, config, len(session.inputs))
        except SourceError as error:
            failed[entry.camera] = str(error)
            continue
        sources.append(source)
        cameras.append(fitted_camera(session.rig[entry.camera], entry, source))
    if len(sources) < least_cameras(session.inputs):
        expected = f"{session.folder}: expected at least {LEAST_CAMERAS} cameras that can be read, got {len(sources)}"
        raise SourceError("; ".join([expected, *failed.values()]))
    for camera, why in failed.items():
        warn_caller(f"{why}; continues without camera {camera}")
    rig = dataclasses.replace(session.rig, cameras=tuple(cameras))
    timeline = common_timeline({one.camera: one.times_ns() for one in sources}, config.rate_hz, config.start_s, config.end_s)
    detector = build_detector(config.detector, rig)
    return Opened(
        session=session,
        config=config,
        rig=rig,
        timeline=timeline,
        skeleton=detector.skeleton,
        joint_centres=detector.joint_centres,
        images=ImageTimeSteps(rig, sources, detector, timeline, _lost),
        sources=tuple(sources),
        network=getattr(detector, "network", {}),
    )


def _lost(camera: str, error: SourceError) -> None:
    warn_caller(f"{error}; continues without camera {camera} from here")


def _check_rate(session: Session, config: TrackConfig) -> None:
    """Raise InputError for images without any time of capture."""
    untimed = [one.camera for one in session.inputs if one.kind == "images" and not (one.path / TIMES_FILE).is_file()]
    if untimed and config.rate_hz is None:
        raise InputError(
            f"{session.folder}: the images of {choices(untimed)} do not state their frame rate; add `rate_hz=HZ`, "
            f"rate_hz = HZ to {CONFIG_FILE}, or {TIMES_FILE} (columns file, t_s) to each folder"
        )


def source_config(entry: Input, config: TrackConfig, cameras: int = 1) -> VideoConfig | ImagesConfig:
    """How the video or images of one camera are read, of so many that are decoded at the same time."""
    offset_s, drift_ppm = entry.settings.offset_s, entry.settings.drift_ppm
    if entry.kind != "videos":
        return ImagesConfig(entry.path, entry.camera, config.rate_hz, offset_s, drift_ppm)
    # threads of its own cost a video a third more processor time: they help only where cameras leave cores idle
    return VideoConfig(entry.path, entry.camera, offset_s, drift_ppm, threads=usable_cores() > cameras)


def build_source(entry: Input, config: TrackConfig, cameras: int = 1) -> RecordedSource:
    """Open the video or images of one camera, see `source_config`, with its depth images where there are any."""
    source, given = source_config(entry, config, cameras).build(), entry.settings
    return DepthSource(source, entry.depth, given.offset_s, given.drift_ppm) if entry.depth else source


# 2D poses in files of other tools. Their frame rate: as set, or as the videos next to them state it.


def pose2d_rate_hz(session: Session, config: TrackConfig) -> float:
    """Frames per second of a session's 2D poses.

    ``rate_hz`` of the config (``--rate``); without it, that of the videos in the session's folder.

    Raises:
        InputError: neither is known, or two videos have different rates.
    """
    if config.rate_hz is not None:
        return config.rate_hz
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
    for path in data_entries(folder, "videos"):
        try:
            times = VideoConfig(path, path.stem).build().times_ns()
        except SourceError:
            continue
        if (period_ns := frame_period_ns(times)) is not None:
            yield path.name, 1e9 / period_ns


def _poses(session: Session, config: TrackConfig) -> Opened:
    """2D poses, all read at once; frames of one number belong together, and each camera gives the one nearest to a time step."""
    folders = read_session_poses(session, config.keypoints)
    _check_one_skeleton(folders)
    first, timeline = _numbered(session, folders, config)
    skeleton = folders[0].skeleton
    return Opened(
        session=session,
        config=config,
        rig=stated_rig(session),
        timeline=timeline,
        skeleton=skeleton,
        joint_centres=_joint_centres_of_set(skeleton),
        stated=_stated(folders, [entry.settings for entry in session.inputs], timeline, first),
        gaps=incomplete_cameras([_coverage(folder, timeline, first) for folder in folders]),
    )


def _numbered(session: Session, folders: Sequence[Pose2DFrames], config: TrackConfig) -> tuple[int, Timeline]:
    """The number of the first frame to use, and the time steps of it and those that follow at the rate of `pose2d_rate_hz`.

    Raises:
        InputError: no frame between start_s and end_s, or a frame rate that is not known. SourceError: too many time steps.
    """
    rate_hz = pose2d_rate_hz(session, config)
    period_ns = round(1e9 / rate_hz)
    first = min(folder.numbers[0] for folder in folders)
    last = max(folder.numbers[-1] for folder in folders)
    skip = 0 if config.start_s is None else max(0, round(config.start_s * rate_hz))
    count = last - first + 1 if config.end_s is None else min(last - first, round(config.end_s * rate_hz)) + 1
    if count - skip < 1:
        raise InputError(
            f"{session.folder}: no 2D pose from {config.start_s} to {config.end_s} s; "
            f"there are {last - first + 1} at {rate_hz:g} Hz"
        )
    check_time_steps(count - skip, rate_hz, f"{session.folder}: 2D poses with frame numbers {first} to {last}")
    return first + skip, Timeline(skip * period_ns, period_ns, count - skip)


def _stated(folders: Sequence[Pose2DFrames], settings: Sequence[CameraInput], line: Timeline, first: int) -> Observations:
    """All people in the files of these time steps; `first` is the frame number of the first one."""
    zero_ns = first * line.period_ns - line.start_ns

    def detected(folder: Pose2DFrames, camera: CameraInput, t_ns: int) -> Detections2D:
        offset_ns, period_ns = round(camera.offset_s * 1e9), line.period_ns * (1 + 1e-6 * camera.drift_ppm)
        number = round((t_ns + zero_ns - offset_ns) / period_ns)
        return folder.frame(number, round(number * period_ns) + offset_ns - zero_ns)

    def part(begin: int) -> Observations:
        batches = []
        for i in range(begin, min(begin + _PART_STEPS, line.count)):
            found = tuple(detected(folder, one, line.t_ns(i)) for folder, one in zip(folders, settings, strict=True))
            batches.append(DetectionBatch(step=i - begin, t_ns=line.t_ns(i), kind=LookKind.STATED, detections=found))
        return Observations.from_batches(folders[0].skeleton, [folder.camera for folder in folders], batches)

    return Observations.concatenate([part(begin) for begin in range(0, line.count, _PART_STEPS)])


def _coverage(folder: Pose2DFrames, line: Timeline, first: int) -> Coverage:
    wanted = range(first, first + line.count)
    there = [number for number in folder.numbers if number in wanted]
    expected = min(folder.numbers[-1], wanted[-1]) - max(folder.numbers[0], first) + 1
    end_ns = line.t_ns(there[-1] - first) if there else None
    return Coverage(folder.camera, max(0, expected), len(there), end_ns, line.period_ns)


def read_session_poses(session: Session, keypoints: str) -> list[Pose2DFrames]:
    """2D poses of all cameras of a session, see `read_pose2d_of_cameras`."""
    paths = {entry.camera: entry.path for entry in session.inputs}
    return read_pose2d_of_cameras(paths, keypoints)


def _joint_centres_of_set(skeleton: Skeleton) -> JointCentres | None:
    """Joint centres for files that name no network: MediaPipe's keypoints are of the networks that come with us."""
    if skeleton.name == "blazepose33":
        file = default_cards()[-1].joint_centres_file
        return read_joint_centres(file) if file else None
    return None


def _check_one_skeleton(folders: list[Pose2DFrames]) -> None:
    kinds: dict[Skeleton, str] = {folder.skeleton: folder.camera for folder in folders}
    if len(kinds) > 1:
        named = [f"{skeleton.name} (camera {camera})" for skeleton, camera in kinds.items()]
        raise InputError(f"2D pose folders: expected one skeleton for all cameras, got {choices(named)}")


def stated_rig(session: Session) -> Rig:
    """The cameras of 2D poses in the order of the inputs: a stated crop moves the image, whose size is not in these files.

    Raises:
        InputError: a stated scale, which would need that size.
    """
    if scaled := [entry.camera for entry in session.inputs if entry.settings.scale]:
        raise InputError(
            f"{session.folder}: camera {choices(scaled)}: scale: 2D poses do not state the size of their images; "
            f"scale size and matrix in {session.rig_path} instead"
        )
    cameras = [(session.rig[entry.camera], entry.settings.crop) for entry in session.inputs]
    fitted = tuple(camera.cropped(*crop, camera.size_wh) if crop else camera for camera, crop in cameras)
    return dataclasses.replace(session.rig, cameras=fitted)
