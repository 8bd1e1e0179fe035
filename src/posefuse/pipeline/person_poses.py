"""2D poses of one person in videos of cameras whose poses are not known yet.

Each camera's person is followed in its own images first. A rough rig made from that predicts in every camera where to look,
as `posefuse track` does, so that the second pass misses no frame and takes no other person: on four real cameras the rig is
24 mm off, and without it, with 90 % of the keypoints in place of 98 %, refused (a camera seems to turn by 9 degrees).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posefuse.association import AssociateSettings
from posefuse.calibration.clocks.person_tracks import PersonTrack
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.person.solve import rough_rig, unplaced_clocks
from posefuse.calibration.person.views import PersonViews, choose_person, person_views
from posefuse.core import (
    Camera,
    Detections2D,
    Detector,
    Progress,
    Region,
    Rig,
    Source,
    silent,
    views_over_time,
)
from posefuse.core.arrays import Array
from posefuse.core.duplicate_share import DUPLICATE_SHARE
from posefuse.core.duplicates import duplicates
from posefuse.core.values import keypoint_boxes
from posefuse.detection import region_from_keypoints
from posefuse.detection.build import DetectorChoice, build_detector, fetch_networks
from posefuse.fusion import FuseSettings
from posefuse.pipeline.config import CameraInput
from posefuse.pipeline.following import FollowedLog, PeopleFollower
from posefuse.pipeline.second_pass import long_enough, poses_over_time
from posefuse.pipeline.session import Input, fitted_camera
from posefuse.pipeline.time_steps import ImageTimeSteps, Timeline, common_timeline, decoded
from posefuse.sources import RecordedSource, VideoConfig
from posefuse.tracking import SmoothSettings, sides_like

# of a recording, from its middle; errors of neighbouring frames are correlated, so more frames add little to a minute
_MOST_S, _USUAL_HZ = 60.0, 15.0
# a shorter walk gives a rig by as many, where it has the frames: what it lacks in time to average errors it gets in frames
_WALK_STEPS = _MOST_S * _USUAL_HZ
# frames between two searches of whole images: for a lost person, and for further people
_SEARCH_EVERY, _LOOK_ROUND_EVERY = 5, 15
_MOST_PEOPLE = 3
_APART, _TOGETHER = "finding the person", "finding the person again, with all cameras"


@dataclass(frozen=True, kw_only=True, eq=False)
class PersonSeen:
    """What the cameras saw of one person.

    Attributes:
        tracks: one per camera, with times that are corrected by `clocks`. cameras: as they apply to the images.
        clocks: found first; None where the cameras are synchronised. several_in: cameras that see further people.
    """

    tracks: tuple[PersonTrack, ...]
    cameras: tuple[Camera, ...]
    clocks: ClockEstimate | None
    several_in: tuple[str, ...] = ()


def person_in_videos(
    paths: Mapping[str, Path],
    lenses: Rig,
    length: KnownLength,
    choice: DetectorChoice,
    progress: Progress = silent,
    clocks: str = "together",
    most_s: float = 10.0,
) -> PersonSeen:
    """The person in every video; of several people the one that most cameras see together.

    Args:
        paths: video of each camera. lenses: a camera for each of them; its pose is not used.
        length: sets the scale. choice: the detector.
        clocks, most_s: as `unplaced_clocks` has them.

    Raises:
        CalibrationError: cameras that cannot be linked by what they see. InputError, SourceError: unusable videos.
    """
    sources = [VideoConfig(path, name).build() for name, path in paths.items()]
    cameras = tuple(
        fitted_camera(lenses[source.camera], Input(source.camera, "videos", path, CameraInput()), source)
        for source, path in zip(sources, paths.values(), strict=True)
    )
    timeline = timeline_of(sources, steps=_WALK_STEPS)
    fetch_networks(choice, progress)
    detector = build_detector(choice, Rig(cameras))
    chosen = choose_person(poses_apart(sources, detector, timeline, progress), cameras)
    apart = chosen.tracks
    found = unplaced_clocks(apart, cameras, length, clocks, most_s)
    if found is not None:
        progress(_APART, timeline.count, timeline.count, "the cameras are not synchronised; continuing with the offsets found")
        sources = [VideoConfig(path, name, *found.correction(c)).build() for c, (name, path) in enumerate(paths.items())]
        timeline = timeline_of(sources, steps=_WALK_STEPS)
    alone = person_views(apart, found)
    rig = rough_rig(alone, cameras, length)
    people = _MOST_PEOPLE if chosen.several_in else 1
    views = poses_together(sources, detector, timeline, rig, alone, people=people, progress=progress)
    return PersonSeen(tracks=views.tracks(), cameras=cameras, clocks=found, several_in=chosen.several_in)


def timeline_of(sources: Sequence[RecordedSource], seconds: float = _MOST_S, steps: float = 1.0) -> Timeline:
    """Time steps in `seconds` from the middle of the recordings, at the cameras' own rate or less.

    Less is 15 a second, or every n-th frame where that gives more, and `steps` at most.
    """
    times_ns = {source.camera: np.asarray(source.times_ns()) for source in sources}
    fastest_hz = max(1e9 / float(np.median(np.diff(t))) for t in times_ns.values())
    first_s, last_s = (float(np.median([t[i] for t in times_ns.values()])) / 1e9 for i in (0, -1))
    spare_s = max(0.0, (last_s - first_s - seconds) / 2)
    cut = (first_s + spare_s, last_s - spare_s) if spare_s else (None, None)
    every = max(math.ceil(fastest_hz * (last_s - first_s - 2 * spare_s) / steps), 1)
    most_hz = max(_USUAL_HZ, fastest_hz / every)
    return common_timeline(times_ns, min(fastest_hz, most_hz), *cut)


def poses_apart(
    sources: Sequence[Source], detector: Detector, timeline: Timeline, progress: Progress = silent
) -> dict[str, list[Detections2D]]:
    """The people of each camera at the time steps of the timeline, followed from frame to frame."""
    followed = {source.camera: _Followed() for source in sources}
    start_ns, end_ns = timeline.span_ns
    with closing(decoded(sources, start_ns, timeline.period_ns, end_ns)) as sets:
        for done, one in enumerate(sets, start=1):
            frames = [frame for frame in one.frames if frame is not None and followed[frame.camera].wants()]
            regions = [followed[frame.camera].regions() for frame in frames]
            for frame, found in zip(frames, detector.detect(frames, regions), strict=True):
                followed[frame.camera].take(found)
            progress(_APART, done, timeline.count)
    return {name: one.poses for name, one in followed.items()}


class _Followed:
    """One camera's people."""

    def __init__(self) -> None:
        self.poses: list[Detections2D] = []
        self._regions: list[Region] = []
        self._rest, self._look_round = 0, 0

    def wants(self) -> bool:
        """Whether the next frame is worth a look: a search without success pauses for a while."""
        self._rest -= 1
        self._look_round -= 1
        return bool(self._regions) or self._rest < 0

    def regions(self) -> list[Region] | None:
        """Where to look; None is everywhere."""
        if self._look_round < 0 or not self._regions:
            self._look_round = _LOOK_ROUND_EVERY
            return None
        return self._regions

    def take(self, found: Detections2D) -> None:
        """Keep the people among those found, the largest first."""
        self._rest = _SEARCH_EVERY
        there = np.isfinite(found.xy_img).all(axis=-1).any(axis=-1)
        people = found.people(there & ~duplicates(found, DUPLICATE_SHARE))
        box = keypoint_boxes(people.xy_img, people.score)
        people = people.people(np.argsort(-(box[:, 2:] - box[:, :2]).max(axis=1), kind="stable")[:_MOST_PEOPLE])
        regions = [region_from_keypoints(xy, found.skeleton) for xy in people.xy_img]
        self._regions = [region for region in regions if region is not None]
        if len(people):
            self.poses.append(people)


def poses_together(
    sources: Sequence[RecordedSource], detector: Detector, timeline: Timeline, rig: Rig, alone: PersonViews, *, people: int,
    progress: Progress,
) -> PersonViews:  # fmt: skip
    """The same person in every camera, each view predicted by the others.

    Args:
        rig: in metres, and may be rough. alone: the person as each camera followed them by itself.
        people: followed at most, so that other people are not taken for the person.

    Raises:
        InputError: no person could be followed. SourceError: a video breaks off.
    """
    images = ImageTimeSteps(rig, sources, detector, timeline)
    follower = PeopleFollower(
        skeleton=detector.skeleton, rig=rig, associating=AssociateSettings(max_people=people), fusing=FuseSettings()
    )
    log = FollowedLog(follower)
    try:
        for done, one in enumerate(follower.follow(images.steps()), start=1):
            log.add(one)
            progress(_TOGETHER, done, timeline.count)
    finally:
        images.close()
    observations = log.observations()
    views = views_over_time(observations, long_enough(observations))
    # a view that takes left for right for a while is wrong in all its limbs at once
    steadied = poses_over_time(views, rig, FuseSettings(), SmoothSettings())
    named = sides_like(steadied, rig, views)
    person = _nearest_person(views.t_ns, views.xy_img, alone)
    by_camera = [np.moveaxis(values[:, person], 1, 0) for values in (named.xy_img, named.score, named.sigma_px)]
    return PersonViews(rig.names, views.skeleton, views.t_ns, *by_camera)


def _nearest_person(t_ns: Array, xy_img: Array, alone: PersonViews) -> int:
    """Which of the people (T, N, C, K, 2) the cameras followed by themselves; those absent are infinitely far."""
    at = np.searchsorted(alone.t_ns, t_ns).clip(0, len(alone.t_ns) - 1)
    away = np.linalg.norm(xy_img - np.moveaxis(alone.xy_img[:, at], 0, 1)[:, None], axis=-1)
    shared = np.isfinite(away).sum(axis=(0, 2, 3))
    usual = [float(np.nanmedian(away[:, n])) if shared[n] else np.inf for n in range(away.shape[1])]
    return int(np.argmin(usual))
