"""Where the person is in the recordings of a session, at the times the cameras themselves state."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posefuse.calibration.clocks.person_tracks import PersonTrack, person_tracks
from posefuse.calibration.report import CalibrationReport
from posefuse.core import InputError, Progress, Rig, silent
from posefuse.detection.build import build_detector
from posefuse.detection.downloading import fetch_networks
from posefuse.health.background import background_of

from .config import TrackConfig
from .opening import build_source
from .person_calibration import frame_period_s
from .person_poses import poses_apart, timeline_of
from .pose2d import read_session_poses, stated_camera
from .pose2d_rate import pose2d_rate_hz
from .session import Session, find_session, fitted_camera


@dataclass(frozen=True, kw_only=True, eq=False)
class SessionSeen:
    """The person as every camera of a session saw them.

    Attributes:
        rig: as it applies to the images. tracks: per camera. frame_period_s: per camera. background: whether the
            cameras stand still; without a check where there are no images.
    """

    rig: Rig
    tracks: tuple[PersonTrack, ...]
    frame_period_s: tuple[float, ...]
    background: CalibrationReport


def person_in_session(folder: Path, config: TrackConfig, seconds: float, progress: Progress = silent) -> SessionSeen:
    """The person in `seconds` from the middle of the recordings of a session.

    Raises:
        InputError: no session, several kinds of data, or 2D poses without a frame rate.
    """
    session = find_session(folder, config)
    # the order of the cameras in the rig file is of no account
    session = replace(session, inputs=tuple(sorted(session.inputs, key=lambda entry: entry.camera)))
    kinds = {entry.kind for entry in session.inputs}
    if len(kinds) > 1:
        raise InputError(f"{session.folder}: expected one kind of data for all cameras, got {', '.join(sorted(kinds))}")
    if kinds == {"pose2d"}:
        return _from_files(session, config, seconds)
    return _from_images(session, config, seconds, progress)


def _from_images(session: Session, config: TrackConfig, seconds: float, progress: Progress) -> SessionSeen:
    """From videos or image folders, at their own times, without the corrections of the settings."""
    as_recorded = [replace(entry, settings=replace(entry.settings, offset_s=0.0, drift_ppm=0.0)) for entry in session.inputs]
    sources = [build_source(entry, config, len(as_recorded)) for entry in as_recorded]
    cameras = [fitted_camera(session.rig[one.camera], entry, one) for entry, one in zip(as_recorded, sources, strict=True)]
    rig = replace(session.rig, cameras=tuple(cameras))
    period_s = tuple(frame_period_s(np.asarray(source.times_ns())) for source in sources)
    timeline = timeline_of(sources, seconds)
    fetch_networks(config.detector, progress)
    detector = build_detector(config.detector, rig)
    tracks = person_tracks(poses_apart(sources, detector, timeline, progress))
    background = background_of(sources, rig.cameras, timeline).report
    return SessionSeen(rig=rig, tracks=tracks, frame_period_s=period_s, background=background)


def _from_files(session: Session, config: TrackConfig, seconds: float) -> SessionSeen:
    poses = read_session_poses(session, config.keypoints)
    rate_hz = pose2d_rate_hz(session, config)
    found = {}
    for entry, one in zip(session.inputs, poses, strict=True):
        frames = list(one.frames(rate_hz))
        spare = max(0, len(frames) - round(seconds * rate_hz)) // 2
        found[entry.camera] = frames[spare : len(frames) - spare]
    cameras = tuple(stated_camera(session.rig[entry.camera], entry) for entry in session.inputs)
    rig = replace(session.rig, cameras=cameras)
    return SessionSeen(
        rig=rig,
        tracks=person_tracks(found),
        frame_period_s=(1 / rate_hz,) * len(cameras),
        background=CalibrationReport("background", ()),
    )
