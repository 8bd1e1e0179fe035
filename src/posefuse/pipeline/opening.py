"""A session made ready for tracking: sources opened, the detector built, the time steps known."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import numpy as np

from posefuse.core import InputError, JointCentres, Observations, Rig, Skeleton, SourceError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.foundation.platform import usable_cores
from posefuse.sources import RecordedSource

from .config import CONFIG_FILE, TrackConfig
from .images import ImageTimeSteps, Timeline, common_timeline
from .session import LEAST_CAMERAS, Input, Session, fitted_camera, least_cameras
from .time_steps import TimeStep

Say = Callable[[str], None]


class TimeSteps(Protocol):
    """The time steps of an opened session."""

    @property
    def skeleton(self) -> Skeleton:
        """The detector's keypoints."""
        ...

    @property
    def joint_centres(self) -> JointCentres | None:
        """Where joint centres lie relative to the keypoints; None where that is not known."""
        ...

    def steps(self, stored: Observations | None = None) -> Iterator[TimeStep]:
        """The time steps after those of `stored`; may be called once."""
        ...

    def incomplete(self) -> list[str]:
        """One line for each camera of which part cannot be read, or that ends before the others; after all steps."""
        ...

    def close(self) -> None:
        """Stop decoding and release files."""
        ...


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Opened:
    """A session that can be tracked.

    Attributes:
        session, config: as given. rig: the cameras as they apply to the images. steps: the time steps, to be closed.
        timeline: the times that they are expected at. sources: of images; empty for 2D poses.
        network: what looks at images, and what is not known of it, by name; empty for 2D poses.
    """

    session: Session
    config: TrackConfig
    rig: Rig
    steps: TimeSteps
    timeline: Timeline
    sources: tuple[RecordedSource, ...] = ()
    network: Mapping[str, str] = dataclasses.field(default_factory=dict)


def open_session(session: Session, config: TrackConfig, warn: Say) -> Opened:
    """Open the data of all cameras and build the detector; cameras that cannot be read are reported to `warn`.

    Raises:
        PosefuseError: several kinds of data, fewer than two cameras that can be read, nothing recorded in the time asked for.
    """
    kinds = {entry.kind for entry in session.inputs}
    if len(kinds) > 1:
        raise InputError(f"{session.folder}: expected one kind of data for all cameras, got {choices(sorted(kinds))}")
    steps: TimeSteps
    if kinds == {"pose2d"}:
        from .pose2d import pose2d_time_steps

        rig, steps, timeline = pose2d_time_steps(session, config)
    else:
        return _images(session, config, warn)
    return Opened(session=session, config=config, rig=rig, steps=steps, timeline=timeline)


def _images(session: Session, config: TrackConfig, warn: Say) -> Opened:
    from posefuse.detection.build import build_detector

    _check_rate(session, config)
    sources, cameras, failed = [], [], list[str]()
    for entry in session.inputs:
        try:
            source = build_source(entry, config, len(session.inputs))
        except SourceError as error:
            failed.append(f"{entry.camera}: {error}")
            warn(f"{error}; continues without camera {entry.camera}")
            continue
        sources.append(source)
        cameras.append(fitted_camera(session.rig[entry.camera], entry, source))
    if len(sources) < least_cameras(session.inputs):
        expected = f"{session.folder}: expected at least {LEAST_CAMERAS} cameras that can be read, got {len(sources)}"
        raise SourceError("; ".join([expected, *failed]))
    rig = dataclasses.replace(session.rig, cameras=tuple(cameras))
    timeline = common_timeline({s.camera: _times(s) for s in sources}, config.rate_hz, config.start_s, config.end_s)
    detector = build_detector(config.detector, rig)
    lost = lambda name, error: warn(f"{error}; continues without camera {name} from here")  # noqa: E731
    return Opened(
        session=session,
        config=config,
        rig=rig,
        steps=ImageTimeSteps(rig, sources, detector, timeline, lost),
        timeline=timeline,
        sources=tuple(sources),
        network=getattr(detector, "network", {}),
    )


def _check_rate(session: Session, config: TrackConfig) -> None:
    """Raise InputError for images without any time of capture."""
    from posefuse.formats.frame_times import TIMES_FILE

    untimed = [one.camera for one in session.inputs if one.kind == "images" and not (one.path / TIMES_FILE).is_file()]
    if untimed and config.rate_hz is None:
        raise InputError(
            f"{session.folder}: the images of {choices(untimed)} do not state their frame rate; add `rate_hz=HZ`, "
            f"rate_hz = HZ to {CONFIG_FILE}, or {TIMES_FILE} (columns file, t_s) to each folder"
        )


def build_source(entry: Input, config: TrackConfig, cameras: int = 1) -> RecordedSource:
    """Open the videos or images of one camera, of so many that are decoded at the same time."""
    from posefuse.sources import DepthSource, ImagesConfig, VideoConfig

    offset_s, drift_ppm = entry.settings.offset_s, entry.settings.drift_ppm
    source: RecordedSource
    if entry.kind == "videos":
        # threads of its own cost a video a third more processor time: they help only where cameras leave cores idle
        threads = usable_cores() > cameras
        source = VideoConfig(entry.path, entry.camera, offset_s, drift_ppm, threads=threads).build()
    else:
        source = ImagesConfig(entry.path, entry.camera, config.rate_hz, offset_s, drift_ppm).build()
    return DepthSource(source, entry.depth, offset_s, drift_ppm) if entry.depth else source


def _times(source: Any) -> Array:
    return np.asarray(source.times_ns())
