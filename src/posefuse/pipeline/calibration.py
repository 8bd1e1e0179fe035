"""Camera poses, and clock offsets where they are needed, from what the cameras recorded of one walking person."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from posefuse.calibration.clocks.person_tracks import PersonTrack, person_tracks
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.person.solve import PersonCalibration, at_clocks, calibrate_tracks, unplaced_clocks
from posefuse.calibration.person.views import choose_person
from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration
from posefuse.calibration.targets.recordings import is_recording
from posefuse.core import Camera, InputError, Progress, Rig, silent
from posefuse.core.errors import choices
from posefuse.detection.build import DetectorChoice, build_detector, fetch_networks
from posefuse.formats.pose2d import read_pose2d_of_cameras
from posefuse.health.background import background_of
from posefuse.sources import VIDEO_SUFFIXES, VideoConfig

from .config import TrackConfig
from .opening import build_source, pose2d_rate_hz, read_session_poses, stated_rig
from .person_poses import PersonSeen, person_in_videos, poses_apart, timeline_of
from .session import LEAST_CAMERAS, Session, find_session, fitted_camera


def check_recordings(paths: Mapping[str, Path]) -> None:
    """Raise InputError where there are too few recordings, or one does not exist or is a folder of images."""
    absent = [str(path) for path in paths.values() if not path.exists()]
    if absent:
        raise InputError(f"person: no such file or folder: {choices(absent)}")
    # OpenPose writes images to the folder of its poses where it is asked to
    folders = [path for path in paths.values() if path.is_dir() and not any(path.glob("*.json"))]
    images = [str(path) for path in folders if is_recording(path)]
    if images:
        raise InputError(f"person: expected videos or 2D poses, got images: {choices(images)}; make a video of each folder")
    if len(paths) < LEAST_CAMERAS:
        raise InputError(f"person: expected at least {LEAST_CAMERAS} cameras, got {len(paths)}")


def background_of_person(paths: Mapping[str, Path], cameras: tuple[Camera, ...]) -> CalibrationReport:
    """Whether the cameras stand still in the part of their videos that is used; nothing to check in 2D poses."""
    if any(path.suffix.lower() not in VIDEO_SUFFIXES for path in paths.values()):
        return CalibrationReport("background", ())
    sources = [VideoConfig(path, name).build() for name, path in paths.items()]
    return background_of(sources, cameras, timeline_of(sources).span_ns).report


def find_person(
    paths: Mapping[str, Path],
    cameras: tuple[Camera, ...],
    length: KnownLength,
    detector: DetectorChoice,
    rate_hz: float | None,
    clocks: str,
    most_s: float,
    progress: Progress = silent,
) -> PersonSeen:
    """The person in every recording: videos, or 2D poses of another tool.

    Args:
        cameras: intrinsics in the order of `paths`; their poses are not used. detector: for videos. rate_hz: of 2D poses.
        clocks, most_s: as of `unplaced_clocks`.

    Raises:
        InputError: both kinds of recordings, or no frame rate. CalibrationError: cameras that cannot be linked.
    """
    videos = [path for path in paths.values() if path.suffix.lower() in VIDEO_SUFFIXES]
    if len(videos) == len(paths):
        return person_in_videos(paths, Rig(cameras), length, detector, progress, clocks=clocks, most_s=most_s)
    if videos:
        raise InputError(f"person: expected videos or 2D poses for all cameras, got both: {choices(map(str, paths.values()))}")
    if rate_hz is None:
        raise InputError("person: 2D poses do not state their frame rate: add `rate_hz=HZ`")
    poses = read_pose2d_of_cameras(paths)
    chosen = choose_person({one.camera: list(one.frames(rate_hz)) for one in poses}, cameras)
    first = unplaced_clocks(chosen.tracks, cameras, length, clocks, most_s)
    tracks = chosen.tracks if first is None else at_clocks(chosen.tracks, first)
    return PersonSeen(tracks=tracks, cameras=cameras, clocks=first, several_in=chosen.several_in)


def solve_person(
    seen: PersonSeen, length: KnownLength, *, with_drift: bool, upside_down: Sequence[str] = ()
) -> tuple[PersonCalibration, ClockEstimate | None]:
    """The rig, and the clocks where the cameras are not synchronised.

    Raises:
        RefusedCalibration: a check fails; it carries the report, which names the cameras with several people in view.
    """
    try:
        found, clocks = calibrate_tracks(seen.tracks, seen.cameras, length, seen.clocks, with_drift, tuple(upside_down))
    except RefusedCalibration as refused:
        if not seen.several_in:
            raise
        report = refused.report
        words = f"several people are in view of {', '.join(seen.several_in)}, and another one may be followed in one camera"
        alone = Check("one person in view", False, words, "record one person alone")
        raise RefusedCalibration(replace(report, checks=(*report.checks, alone)), refused.kept) from None
    if not seen.several_in:
        return found, clocks
    note = (
        f"several people are in view of {', '.join(seen.several_in)}: the one that most cameras see together was taken,"
        " and the height has to be theirs"
    )
    return replace(found, report=replace(found.report, notes=(*found.report.notes, note))), clocks


# Where the person is in the recordings of a session, at the times the cameras themselves state.


@dataclass(frozen=True, kw_only=True, eq=False)
class SessionSeen:
    """The person as every camera of a session saw them.

    Attributes:
        rig: as it applies to the images. tracks: per camera. background: whether the cameras stand still; without a check where
            there are no images.
    """

    rig: Rig
    tracks: tuple[PersonTrack, ...]
    background: CalibrationReport


def person_in_session(folder: Path, config: TrackConfig, seconds: float, progress: Progress = silent) -> SessionSeen:
    """The person in `seconds` from the middle of the recordings of a session.

    Raises:
        InputError: no session, several kinds of data, or 2D poses without a frame rate.
    """
    session = find_session(folder, config)
    # the order of the cameras in the rig file is of no account
    session = replace(session, inputs=tuple(sorted(session.inputs, key=lambda entry: entry.camera)))
    if session.kind == "pose2d":
        return _from_files(session, config, seconds)
    return _from_images(session, config, seconds, progress)


def _from_images(session: Session, config: TrackConfig, seconds: float, progress: Progress) -> SessionSeen:
    """From videos or image folders, at their own times, without the corrections of the settings."""
    as_recorded = [replace(entry, settings=replace(entry.settings, offset_s=0.0, drift_ppm=0.0)) for entry in session.inputs]
    sources = [build_source(entry, config, len(as_recorded)) for entry in as_recorded]
    cameras = [fitted_camera(session.rig[one.camera], entry, one) for entry, one in zip(as_recorded, sources, strict=True)]
    rig = replace(session.rig, cameras=tuple(cameras))
    timeline = timeline_of(sources, seconds)
    fetch_networks(config.detector, progress)
    detector = build_detector(config.detector, rig)
    tracks = person_tracks(poses_apart(sources, detector, timeline, progress))
    background = background_of(sources, rig.cameras, timeline.span_ns).report
    return SessionSeen(rig=rig, tracks=tracks, background=background)


def _from_files(session: Session, config: TrackConfig, seconds: float) -> SessionSeen:
    poses = read_session_poses(session, config.keypoints)
    rate_hz = pose2d_rate_hz(session, config)
    found = {}
    for entry, one in zip(session.inputs, poses, strict=True):
        frames = list(one.frames(rate_hz))
        spare = max(0, len(frames) - round(seconds * rate_hz)) // 2
        found[entry.camera] = frames[spare : len(frames) - spare]
    return SessionSeen(rig=stated_rig(session), tracks=person_tracks(found), background=CalibrationReport("background", ()))
