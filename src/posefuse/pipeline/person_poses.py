"""2D poses of one person in videos of cameras whose poses are not known yet.

Each camera's person is followed in its own images first. A rough rig made from that predicts in every camera where to look,
as `posefuse track` does, so that the second pass misses no frame and takes no other person.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np

from posefuse.association import AssociateSettings
from posefuse.calibration.clocks.person_tracks import person_tracks, prominent
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.person.settle import unplaced_clocks
from posefuse.calibration.person.solve import rough_rig
from posefuse.calibration.person.views import PersonViews, person_views
from posefuse.core import (
    Camera,
    Detections2D,
    Detector,
    Frame,
    Progress,
    Region,
    Rig,
    Source,
    SourceError,
    silent,
    views_over_time,
)
from posefuse.core.arrays import Array
from posefuse.detection import region_from_keypoints
from posefuse.detection.build import DetectorChoice, build_detector
from posefuse.detection.downloading import fetch_networks
from posefuse.fusion import FuseSettings
from posefuse.pipeline.config import CameraInput
from posefuse.pipeline.following import PeopleFollower, observations_of
from posefuse.pipeline.images import ImageInstants, Timeline, common_timeline
from posefuse.pipeline.second_pass import long_enough, poses_over_time
from posefuse.pipeline.session import Input, fitted_camera
from posefuse.sources import FramesAhead, RecordedSource, VideoConfig, VideoSource, frame_sets
from posefuse.tracking import SmoothSettings, sides_like

# frames between two searches of whole images for a lost person
_SEARCH_EVERY = 5
_APART, _TOGETHER = "finding the person", "finding the person again, with all cameras"


def person_in_videos(
    paths: Mapping[str, Path],
    lenses: Rig,
    length: KnownLength,
    choice: DetectorChoice,
    time_steps: int,
    progress: Progress = silent,
    clocks: str = "together",
    most_s: float = 10.0,
) -> tuple[PersonViews, tuple[Camera, ...], ClockEstimate | None]:
    """The person in every video, the cameras as they apply to the videos' images, and the clocks that the views were read by.

    Args:
        paths: video of each camera. lenses: a camera for each of them; its pose is not used.
        length: sets the scale. choice: the detector. time_steps: used at most.
        clocks, most_s: as `unplaced_clocks` has them.

    Raises:
        CalibrationError: cameras that cannot be linked by what they see. InputError, SourceError: unusable videos.
    """
    sources = [VideoConfig(path, name).build() for name, path in paths.items()]
    cameras = tuple(
        fitted_camera(lenses[source.camera], Input(source.camera, "videos", path, CameraInput()), source)
        for source, path in zip(sources, paths.values(), strict=True)
    )
    timeline = timeline_of(sources, time_steps)
    fetch_networks(choice, progress)
    detector = build_detector(choice, Rig(cameras))
    apart = person_tracks(poses_apart(sources, detector, timeline, progress))
    found = unplaced_clocks(apart, cameras, length, clocks, most_s)
    if found is not None:
        progress(_APART, timeline.count, timeline.count, "the cameras are not synchronised; going on with the offsets found")
        sources = [VideoConfig(path, name, *found.correction(c)).build() for c, (name, path) in enumerate(paths.items())]
        timeline = timeline_of(sources, time_steps)
    rig = rough_rig(person_views(apart, found), cameras, length)
    return poses_together(sources, detector, timeline, rig, progress), cameras, found


def timeline_of(sources: Sequence[VideoSource], time_steps: int) -> Timeline:
    """Time steps at the cameras' own rate, or as many as were asked for."""
    times_ns = {source.camera: np.asarray(source.times_ns()) for source in sources}
    seconds = (max(t[-1] for t in times_ns.values()) - min(t[0] for t in times_ns.values())) / 1e9
    fastest_hz = max(1e9 / float(np.median(np.diff(t))) for t in times_ns.values())
    return common_timeline(times_ns, min(fastest_hz, time_steps / max(seconds, 1e-3)), None, None)


def poses_apart(
    sources: Sequence[Source], detector: Detector, timeline: Timeline, progress: Progress = silent
) -> dict[str, list[Detections2D]]:
    """The most prominent person of each camera at the time steps of the timeline, followed from frame to frame."""
    streams = {source.camera: FramesAhead(source) for source in sources}
    followed = {source.camera: _Followed() for source in sources}
    end_ns = timeline.start_ns + (timeline.count - 1) * timeline.period_ns
    try:
        for done, one in enumerate(frame_sets(streams, timeline.start_ns, timeline.period_ns, end_ns), start=1):
            frames = [frame for frame in one.frames if frame is not None and followed[frame.camera].wants()]
            regions = [followed[frame.camera].regions() for frame in frames]
            for frame, found in zip(frames, detector.detect(frames, regions), strict=True):
                followed[frame.camera].take(frame, found)
            progress(_APART, done, timeline.count)
    finally:
        for stream in streams.values():
            stream.close()
    return {name: one.poses for name, one in followed.items()}


class _Followed:
    """One camera's person."""

    def __init__(self) -> None:
        self.poses: list[Detections2D] = []
        self._region: Region | None = None
        self._middle: Array | None = None
        self._rest = 0

    def wants(self) -> bool:
        """Whether the next frame is worth a look: a search without success pauses for a while."""
        self._rest -= 1
        return self._region is not None or self._rest < 0

    def regions(self) -> list[Region] | None:
        """Where to look; None is everywhere."""
        return None if self._region is None else [self._region]

    def take(self, frame: Frame, found: Detections2D) -> None:
        """Keep the person among those found."""
        self._rest = _SEARCH_EVERY
        person = prominent(found, self._middle)
        self._region = None if person is None else region_from_keypoints(found.xy_img[person], found.skeleton)
        if person is not None:
            self._middle = np.nanmedian(found.xy_img[person], axis=0)
            self.poses.append(found)


def poses_together(
    sources: Sequence[RecordedSource], detector: Detector, timeline: Timeline, rig: Rig, progress: Progress
) -> PersonViews:
    """The same person in every camera, each view predicted by the others; `rig` is in metres, and may be rough.

    Raises:
        InputError: no person could be followed. SourceError: a video breaks off.
    """
    instants, followed = ImageInstants(rig, sources, detector, timeline, _raise), []
    follower = PeopleFollower(skeleton=detector.skeleton, rig=rig, associating=AssociateSettings(), fusing=FuseSettings())
    try:
        for one in follower.follow(instants.steps()):
            followed.append(one)
            progress(_TOGETHER, len(followed), timeline.count)
    finally:
        instants.close()
    observations = observations_of(follower.identified(followed), detector.skeleton, rig)
    views = views_over_time(observations, long_enough(observations))
    # a view that takes left for right for a while is wrong in all its limbs at once
    steadied = poses_over_time(views, rig, FuseSettings(), SmoothSettings())
    named = sides_like(steadied, rig, views)
    by_camera = [np.moveaxis(values[:, 0], 1, 0) for values in (named.xy_img, named.score, named.sigma_px)]
    return PersonViews(rig.names, views.skeleton, views.t_ns, *by_camera)


def _raise(camera: str, error: SourceError) -> NoReturn:
    raise error
