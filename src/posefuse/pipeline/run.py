"""The main job: a session folder to a Recording."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse import __version__
from posefuse.core import InputError, Recording, Rig, Source, SourceError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.health.recorded import rig_findings
from posefuse.health.rig_monitor import OUT_OF_STEP, Finding
from posefuse.tracking import JointCentres

from .clock import StageClock
from .config import TrackConfig
from .following import Seen, follow
from .images import ImageInstants, Timeline, common_timeline
from .second_pass import ViewSequence, poses_over_time, views_over_time
from .session import LEAST_CAMERAS, Input, Session, fitted_camera
from .warm_up import warm_up

Progress = Callable[[int, int], None]
Say = Callable[[str], None]
_WORTH_SAYING_S = 3.0


@dataclasses.dataclass(frozen=True, eq=False)
class Tracked:
    """A recording and what happened on the way.

    Attributes:
        recording: the result. stage_s: wall-clock seconds per stage. interrupted: Ctrl-C ended it early.
        found: per camera, share of its instants in which the person was seen.
        joint_centres: the table keypoints were moved by; None where they stay as the 2D estimator marks them.
    """

    recording: Recording
    stage_s: Mapping[str, float]
    interrupted: bool
    found: Mapping[str, float]
    joint_centres: JointCentres | None


def track_session(session: Session, config: TrackConfig, clock: StageClock, progress: Progress, note: Say, warn: Say) -> Tracked:
    """Run the whole pipeline on a session; news go to `note`, what is not as it should be to `warn`.

    Ctrl-C ends the first pass; what was seen until then is finished and returned.

    Raises:
        PosefuseError: anything that leaves fewer than two usable cameras, or nobody to follow.
    """
    kinds = {entry.kind for entry in session.inputs}
    if len(kinds) > 1:
        raise InputError(f"{session.folder}: expected one kind of data for all cameras, got {choices(sorted(kinds))}")
    with clock.stage("open"):
        rig, instants, timeline = _pose2d(session, config) if kinds == {"pose2d"} else _images(session, config, warn)
    with clock.stage("compile"):
        warm_up(rig, instants.skeleton, config)
    if clock.seconds["compile"] > _WORTH_SAYING_S:
        note(f"numeric kernels compiled in {clock.seconds['compile']:.0f} s; later runs find them on disk")
    seen, interrupted = _follow(instants, rig, config, clock, timeline, progress)
    _check_somebody(seen, rig, warn)
    with clock.stage("smooth"):
        views = views_over_time(seen)
        centres = instants.joint_centres if config.joint_centres else None
        poses = poses_over_time(views, rig, config.fuse, None if config.raw else config.smooth, centres)
    with clock.stage("watch"):
        for finding in rig_findings(views, rig):
            warn(finding_line(finding, session.folder))
    provenance = {
        "posefuse": __version__,
        "rig_id": rig.id,
        "rig_file": session.rig_path.name,
        "session": session.folder.name,
        "inputs": {entry.camera: entry.path.name for entry in session.inputs},
        "config": dataclasses.asdict(config),
        "joint_centres": dataclasses.asdict(centres) if centres else None,
        "interrupted": interrupted,
    }
    recording = Recording(rig, poses, views.xy_img, views.score, views.sigma_px, provenance)
    return Tracked(recording, clock.seconds, interrupted, _found(views), centres)


def finding_line(finding: Finding, session: Path) -> str:
    """When it shows, what is wrong with a camera, and what to do about it."""
    remedy = f"; `posefuse calibrate clocks {session}` finds its offset" if finding.kind == OUT_OF_STEP else ""
    return f"at {finding.t_ns / 1e9:.1f} s: {finding.detail}{remedy}"


def _follow(
    instants: Any, rig: Rig, config: TrackConfig, clock: StageClock, timeline: Timeline, progress: Progress
) -> tuple[list[Seen], bool]:
    seen: list[Seen] = []
    try:
        for one in follow(instants, instants.skeleton, rig, config.associate, config.fuse, clock):
            seen.append(one)
            progress(len(seen), timeline.count)
    except KeyboardInterrupt:
        if len(seen) < 2:
            raise
        return seen, True
    finally:
        instants.close()
    return seen, False


def _images(session: Session, config: TrackConfig, warn: Say) -> tuple[Rig, ImageInstants, Timeline]:
    from posefuse.detection.build import build_detector

    sources, cameras = [], []
    for entry in session.inputs:
        try:
            source = build_source(entry, config)
        except SourceError as error:
            warn(f"{error}; goes on without camera {entry.camera}")
            continue
        sources.append(source)
        cameras.append(fitted_camera(session.rig[entry.camera], entry, source))
    if len(sources) < LEAST_CAMERAS:
        raise SourceError(f"{session.folder}: expected at least {LEAST_CAMERAS} cameras that can be read, got {len(sources)}")
    rig = dataclasses.replace(session.rig, cameras=tuple(cameras))
    timeline = common_timeline({s.camera: _times(s) for s in sources}, config.rate_hz, config.start_s, config.end_s)
    detector = build_detector(config.detector, rig)
    lost = lambda name, error: warn(f"{error}; goes on without camera {name} from here")  # noqa: E731
    return rig, ImageInstants(rig, sources, detector, timeline, lost), timeline


def _pose2d(session: Session, config: TrackConfig) -> tuple[Rig, Any, Timeline]:
    from .pose2d import pose2d_instants

    return pose2d_instants(session, config)


def build_source(entry: Input, config: TrackConfig) -> Source:
    """Open one camera's videos or images."""
    from posefuse.sources import ImagesConfig, VideoConfig

    offset_s, drift_ppm = entry.settings.offset_s, entry.settings.drift_ppm
    if entry.kind == "videos":
        return VideoConfig(entry.path, entry.camera, offset_s, drift_ppm).build()
    return ImagesConfig(entry.path, entry.camera, config.rate_hz or 30.0, offset_s, drift_ppm).build()


def _times(source: Any) -> Array:
    return np.asarray(source.times_ns())


def _check_somebody(seen: list[Seen], rig: Rig, warn: Say) -> None:
    """Name the cause where it happens: cameras in which nobody was ever found."""
    if not seen:
        raise InputError("no frame could be read from any camera")
    found = np.array([[np.nan_to_num(s.views.score[:, c]).max(initial=0.0) > 0 for c in range(len(rig))] for s in seen])
    empty = [name for name, column in zip(rig.names, found.T, strict=True) if not column.any()]
    for name in empty:
        warn(f"camera {name}: no person found in {len(seen)} of {len(seen)} frames")
    if len(rig) - len(empty) < LEAST_CAMERAS:
        raise InputError(
            f"a person was found in {len(rig) - len(empty)} of {len(rig)} cameras; two are needed "
            f"(nobody in: {choices(empty)}); is the calibration the one of these videos?"
        )


def _found(views: ViewSequence) -> dict[str, float]:
    seen = (np.nan_to_num(views.score) > 0).any(axis=(1, 3))
    return {name: float(share) for name, share in zip(views.camera_names, seen.mean(axis=0), strict=True)}
