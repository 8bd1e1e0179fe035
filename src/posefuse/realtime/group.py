"""A camera group: a process that captures from its cameras and turns their newest frames into 2D poses.

While no person is followed, a whole image is searched when it changes, and ever more rarely while it does not.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from posefuse.core import Camera, Detections2D, Frame, InputError, LivePreview, PosefuseError, Region, Rig
from posefuse.core.arrays import Array
from posefuse.core.protocols import NOISE_NOT_FITTED
from posefuse.detection import with_clothing, with_depth
from posefuse.detection.build import DetectorChoice, build_detector
from posefuse.foundation.channel import Channel, ChannelClosed
from posefuse.foundation.platform import lower_priority
from posefuse.outputs.drawing import jpeg_of, shrunk

from .capture import SAMPLE_STEP, Capture, Caught, LiveInput, take_all
from .messages import (
    NOTHING_EXPECTED,
    CannotStart,
    Expected,
    Go,
    KeepVideos,
    Ready,
    SeenView,
    SessionClock,
    ShowImages,
    Status,
    Stop,
)
from .video_keeping import VideoKeeper, wait_for_videos

# a sampled pixel has changed when its brightness differs by more than this: 3.5 standard deviations of the difference of two
# frames of a camera whose noise is 5 levels. Colours add little: of 728 pairs of images of the demo clip at a third of its size,
# 725 differ by colours, and 722 by brightness
_CHANGED_LEVELS = 25
# and so many pixels are a person far away, not a dead pixel
_CHANGED_PIXELS = 4
# a person who stands still changes an image within 0.5 to 3 s only (eight cameras, two rendered scenes)
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.5, 10.0


class SearchSchedule:
    """Of one camera. No clock inside: times come as data.

    Only searches in vain make the next one wait. So a person who is found is searched in every frame, until enough cameras find
    them to follow them; one who is missed, in every frame that differs from the one before, or else after ten seconds.
    """

    def __init__(self) -> None:
        self._in_vain: Array | None = None
        self._next_s = self._wait_s = 0.0

    def due(self, sample: Array, now_s: float) -> bool:
        """Whether to search. sample: (h, w) uint8 brightness of some of the image's pixels. now_s: the time."""
        return self._in_vain is None or now_s >= self._next_s or _differ(sample, self._in_vain)

    def searched(self, sample: Array, now_s: float, found: bool) -> None:
        """An image was searched; `found`: for a person."""
        if found:
            self._in_vain = None
            return
        changed = self._in_vain is None or _differ(sample, self._in_vain)
        self._wait_s = _FIRST_WAIT_S if changed else min(2 * self._wait_s, _LONGEST_WAIT_S)
        self._next_s, self._in_vain = now_s + self._wait_s, sample


def _differ(one: Array, other: Array) -> bool:
    return int(np.count_nonzero(cv2.absdiff(one, other) > _CHANGED_LEVELS)) >= _CHANGED_PIXELS


def search_slot(now_ns: int, every_s: float) -> int:
    """The number of the stretch of time in which every camera searches its whole image once, at its first look.

    It is the same for all cameras: a new person is found where two of them see them at about the same time.
    """
    return now_ns // round(every_s * 1e9)


_LONGER_SIDE_PX = 320
_STATUS_S = 0.25
_IDLE_S = 0.05
_SEND_S = 0.5
# a prediction older than this is useless for choosing where to look
_STALE_NS = 1_000_000_000
# while no person is followed, a frame that is not searched is reported only this long after the one before
_EMPTY_S = 0.2
# leaves the processor to the fusion loop whenever both want it
_NICENESS = 5


def preview_jpeg(frame: Frame, t_ns: int) -> LivePreview:
    """The frame as a small JPEG."""
    small = shrunk(frame.image, _LONGER_SIDE_PX)
    return LivePreview(camera=frame.camera, t_ns=t_ns, jpeg=jpeg_of(small), size_wh=(small.shape[1], small.shape[0]))


@dataclass(frozen=True, kw_only=True)
class GroupPlan:
    """All a group needs to know.

    Attributes:
        rig: all cameras of the session. inputs: the group's own.
        detector: the detector. clock: the session's.
        together: all waiting frames go to the detector in one call.
        most_people: while fewer are followed, whole images are searched every `search_every_s`.
        preview_hz: small images per second and camera; 0 for none.
        videos: an existing folder for the cameras' videos; None: none are kept.
    """

    rig: Rig
    inputs: tuple[LiveInput, ...]
    detector: DetectorChoice
    together: bool = False
    clock: SessionClock
    most_people: int
    search_every_s: float
    preview_hz: float
    videos: Path | None = None


@dataclass(frozen=True, eq=False)
class _Look:
    """A frame that is looked at, when, and where people may be."""

    capture: Capture
    caught: Caught
    started_ns: int
    now_s: float
    regions: Sequence[Region] | None

    @property
    def camera(self) -> str:
        """Its name."""
        return self.capture.entry.camera


def run_group(channel: Channel, plan: GroupPlan) -> None:
    """Body of the process; ends on request, or when its receiver has gone."""
    lower_priority(_NICENESS)
    group = None
    with contextlib.suppress(ChannelClosed):
        try:
            group = _opened(plan, channel)
            group.run()
        except PosefuseError as error:
            channel.send(CannotStart(str(error)), _SEND_S)
    # also when the session was killed
    if group is not None:
        group.finish()


def _opened(plan: GroupPlan, channel: Channel) -> Group:
    cv2.setNumThreads(1)
    group = Group(plan, channel)
    detector = group.detector
    fitted = NOISE_NOT_FITTED not in getattr(detector, "network", {}).get("unknown", "")
    channel.send(Ready(detector.skeleton, detector.joint_centres, fitted), _SEND_S)
    return group


class Group:
    """Captures and the detector of one process."""

    def __init__(self, plan: GroupPlan, channel: Channel) -> None:
        self._plan, self._channel = plan, channel
        self._expected, self._over = NOTHING_EXPECTED, False
        self._news = threading.Condition()
        # why there is no video of a camera, empty where there is one or none is wanted
        self._not_made: dict[str, str] = {}
        self._captures = [Capture(entry, plan.rig[entry.camera], self._news) for entry in plan.inputs]
        self._keep_videos(plan.videos)
        for capture in self._captures:
            capture.open()
        self.detector = build_detector(plan.detector, plan.rig)
        self._looked_s = dict.fromkeys((entry.camera for entry in plan.inputs), 0.0)
        self._searched_slot = dict.fromkeys(self._looked_s, -1)
        self._previewed_s = dict(self._looked_s)
        self._sent_s = dict(self._looked_s)
        self._skipped = dict.fromkeys(self._looked_s, 0)
        self._searches = {entry.camera: SearchSchedule() for entry in plan.inputs}
        self._status_s = 0.0

    def run(self) -> None:
        """Wait for Go, then look at frames until Stop."""
        go = self._wait_for_go()
        if go is None:
            return
        for capture in self._captures:
            capture.begin(go.zero_ns, go.zero_ns + self._plan.clock.offset_ns)
        while not self._over:
            self._send_status()
            self._look_at_next()

    def finish(self) -> None:
        """Close the sources, and finish the videos as long as they make progress; the status reports that to the session."""

        def report() -> None:
            with contextlib.suppress(ChannelClosed):
                self._send_status()

        wait_for_videos([keeper for capture in self._captures for keeper in capture.close()], report)

    def _keep_videos(self, folder: Path | None) -> None:
        for capture in self._captures:
            capture.replace_keeper(self._keeper(folder, capture.entry.camera))

    def _keeper(self, folder: Path | None, camera: str) -> VideoKeeper | None:
        """None also where it cannot be made, as in a process that was started again: no video is written over."""
        self._not_made[camera] = ""
        if folder is None:
            return None
        try:
            return VideoKeeper(folder, camera)
        except InputError as error:
            self._not_made[camera] = str(error)
            return None

    def _take_messages(self) -> None:
        """Of the session: where to look, and what is changed."""
        while (message := self._channel.receive()) is not None:
            if isinstance(message, Expected):
                self._expected = message
            elif isinstance(message, ShowImages):
                self._plan = replace(self._plan, preview_hz=message.rate_hz)
            elif isinstance(message, KeepVideos):
                self._keep_videos(message.folder)
            elif isinstance(message, Stop):
                self._over = True

    def _look_at_next(self) -> None:
        with self._news:
            if all(capture.waiting() is None for capture in self._captures):
                self._news.wait(_IDLE_S)
        self._take_messages()
        with self._news:
            chosen = self._chosen(self._expected)
        for frames in [chosen] if self._plan.together else [[one] for one in chosen]:
            self._take_messages()
            self._look(frames, self._expected)

    def _chosen(self, expected: Expected) -> list[tuple[Capture, Caught]]:
        """The frame of the camera that has waited longest; those of all cameras in one call, or while no person is followed.

        A search of a whole image takes longer than a frame period, and a new person is placed by views of one time: frames
        taken one after another would be apart by as much as the person walks meanwhile.
        """
        if self._plan.together or not self._followed(expected):
            return take_all(self._captures)
        waiting = [capture for capture in self._captures if capture.waiting() is not None]
        return take_all(sorted(waiting, key=lambda capture: self._looked_s[capture.entry.camera])[:1])

    def _followed(self, expected: Expected) -> bool:
        return len(expected.xyz_world) > 0 and self._plan.clock.now_ns() - expected.t_ns <= _STALE_NS

    def _wait_for_go(self) -> Go | None:
        while True:
            self._send_status()
            if not self._channel.wait(_STATUS_S):
                continue
            message = self._channel.receive()
            if isinstance(message, Stop):
                return None
            if isinstance(message, Go):
                return message

    def _look(self, frames: Sequence[tuple[Capture, Caught]], expected: Expected) -> None:
        """Find people in frames of different cameras, in one call, and send what was found."""
        asked = [look for capture, caught in frames if (look := self._asked(capture, caught, expected))]
        for look, found in zip(asked, self._detected(asked), strict=True):
            self._send(look, found)

    def _asked(self, capture: Capture, caught: Caught, expected: Expected) -> _Look | None:
        """What to look for in a frame; None for one that is neither searched nor reported."""
        name = capture.entry.camera
        started_ns, now_s = self._plan.clock.now_ns(), time.monotonic()
        self._looked_s[name] = now_s
        followed = self._followed(expected)
        camera = self._plan.rig[name]
        regions = self._regions(camera, caught.t_ns, expected, started_ns) if followed else self._search_or_nothing(caught, now_s)
        if not followed and regions is not None and now_s - self._sent_s[name] < _EMPTY_S:
            self._skipped[name] += 1
            self._preview(caught)
            return None
        return _Look(capture, caught, started_ns, now_s, regions)

    def _detected(self, asked: Sequence[_Look]) -> list[Detections2D]:
        """Of each frame, in its own time; one without regions is not converted."""
        frames = {i: look.caught.frame for i, look in enumerate(asked) if look.regions is None or look.regions}
        found = dict(zip(frames, self._found(list(frames.values()), [asked[i].regions for i in frames]), strict=True))
        skeleton = self.detector.skeleton
        return [
            found[i] if i in found else Detections2D.empty(look.camera, look.caught.frame.t_ns, skeleton)
            for i, look in enumerate(asked)
        ]

    def _found(self, frames: Sequence[Frame], regions: Sequence[Sequence[Region] | None]) -> list[Detections2D]:
        if not frames:
            return []
        found = [with_depth(one, frame.depth) for one, frame in zip(self.detector.detect(frames, regions), frames, strict=True)]
        if self._plan.most_people == 1:
            return found
        return [with_clothing(one, frame.image) for one, frame in zip(found, frames, strict=True)]

    def _send(self, look: _Look, found: Detections2D) -> None:
        name, caught = look.camera, look.caught
        shown = _in_session(found, caught.shift_ns)
        if look.regions is None:
            sample = caught.frame.pixels.brightness(SAMPLE_STEP)
            self._searches[name].searched(sample, look.now_s, found=len(shown) > 0)
        seen = SeenView(
            detections=shown,
            state=look.capture.state(),
            received_ns=caught.frame.received_ns + caught.shift_ns,
            started_ns=look.started_ns,
            detected_ns=self._plan.clock.now_ns(),
            still=caught.still,
            skipped=self._skipped[name],
        )
        self._channel.send(seen, _SEND_S)
        self._sent_s[name] = look.now_s
        self._skipped[name] = 0
        self._preview(caught)

    def _search_or_nothing(self, caught: Caught, now_s: float) -> Sequence[Region] | None:
        """Where to look while no person is followed: None asks for a search of the whole image."""
        frame = caught.frame
        return None if self._searches[frame.camera].due(frame.pixels.brightness(SAMPLE_STEP), now_s) else ()

    def _regions(self, camera: Camera, t_ns: int, expected: Expected, now_ns: int) -> Sequence[Region] | None:
        """Where the people that are followed should be seen; None asks for a search of the whole image."""
        slot = search_slot(now_ns, self._plan.search_every_s)
        if len(expected.xyz_world) < self._plan.most_people and slot != self._searched_slot[camera.name]:
            self._searched_slot[camera.name] = slot
            return None
        from posefuse.detection import region_from_pose

        skeleton = self.detector.skeleton
        looks = [region_from_pose(camera, xyz, skeleton) for xyz in expected.at(t_ns)]
        return [look for look in looks if look is not None]

    def _preview(self, caught: Caught) -> None:
        if self._plan.preview_hz <= 0:
            return
        now, camera = time.monotonic(), caught.frame.camera
        if now - self._previewed_s[camera] >= 1 / self._plan.preview_hz:
            self._previewed_s[camera] = now
            self._channel.send(preview_jpeg(caught.frame, caught.t_ns))

    def _send_status(self) -> None:
        now = time.monotonic()
        if now - self._status_s >= _STATUS_S:
            self._status_s = now
            states = tuple(capture.state() for capture in self._captures)
            faults = {c.entry.camera: self._not_made[c.entry.camera] or c.video_fault() for c in self._captures}
            known = {camera: fault for camera, fault in faults.items() if fault}
            self._channel.send(Status(self._plan.clock.now_ns(), states, known), _SEND_S)


def _in_session(found: Detections2D, shift_ns: int) -> Detections2D:
    """Session time, and only people who were seen."""
    there = np.any(found.score > 0, axis=-1)
    return replace(found if there.all() else found.people(there), t_ns=found.t_ns + shift_ns)
