"""Cameras without tracking: images with what is wrong in them, and with a target also what is covered so far; videos on request.

Arguments: ``setup`` (a preset) or ``sources`` (by camera name); ``target`` (a target file of the workspace; empty: none);
``record`` (a new folder of the workspace for the videos; empty: none); ``step`` of the calibration that it is for;
``lenses``: whether they are to come from it, too. It ends when it is cancelled, when its sources end, or, with a target, when
enough is covered. What is neither recorded nor shown on any page gives the cameras free after a while.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posefuse.calibration.targets.coverage import Guidance, coverage_picture, new_guidance, seen
from posefuse.calibration.targets.detection import TargetDetector
from posefuse.calibration.targets.kinds import read_target
from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.outputs.drawing import jpeg_of, shrunk_wh
from posefuse.realtime.video_keeping import read_counts
from posefuse.realtime.watching import CameraFeed, FedFrame, exposure_warning
from posefuse_studio.calibrations import Step
from posefuse_studio.focus import focus_warning
from posefuse_studio.guiding import advice_for, enough_for, near_far_of, size_of
from posefuse_studio.jobs import write_json
from posefuse_studio.live_host import Host, Pace, Rates, status_pace
from posefuse_studio.scene.messages import image_message, setup_message
from posefuse_studio.scene.setup import scene_setup
from posefuse_studio.setups import Setup, inputs_of_setup, setup_named
from posefuse_studio.targets import without_floor
from posefuse_studio.workspace import StudioWorkspace

IMAGES_HZ = 15.0
_JUDGE_S, _REST_S, _IDLE_S = 1.0, 0.005, 0.1
_FINISH_S = 90.0
# a page that is loaded again, on a machine that is busy
_UNSEEN_S = 20.0
_SHOWN_PX, _QUALITY = 480, 70


def run(arguments: Mapping[str, Any], workspace: StudioWorkspace, progress: Any) -> dict[str, Any]:
    """Watch until the end; see the module."""
    if arguments.get("setup"):
        setup = setup_named(workspace, str(arguments["setup"]))
    else:
        setup = Setup(name="cameras", sources={str(name): str(what) for name, what in arguments["sources"].items()})
    target = str(arguments.get("target") or "")
    detector = TargetDetector(without_floor(read_target(workspace.existing(target)))) if target else None
    record = str(arguments.get("record") or "")
    inputs = inputs_of_setup(workspace, setup)
    # packets of files come in any encoding, and again from the start where a video begins again: they are encoded again
    packets = bool(record) and all(entry.kind != "video" for entry in inputs)
    with CameraFeed(inputs, packets=packets) as feed:
        videos = None
        if record:
            if workspace.path(record).exists():
                raise InputError(f"{record}: exists already; choose another name")
            videos = workspace.folder(f"{record}/videos")
        watched = _Watch(feed, detector, record, arguments.get("step") or "extrinsics", bool(arguments.get("lenses")))
        progress.listens(watched.host.address)
        feed.begin(videos)
        # a user who has seen enough ends it: what was recorded is complete then, too
        with suppress(KeyboardInterrupt):
            watched.run(stop_when_enough=bool(target))
    state, enough = watched.guidance, watched.enough
    if videos is not None:
        progress("finish the videos", 0, None)
        _wait_finished(videos, feed.cameras)
        covered = {
            "covered": state.covered.tolist(),
            "linked": state.linked.tolist(),
            "together": state.coverage.together.tolist(),
            "cells": state.coverage.cells.tolist(),
        }
        about = {"cameras": list(feed.cameras), "target": target, "enough": enough}
        write_json(workspace.path(f"{record}/coverage.json"), {**about, **covered})
    return {"record": record, "enough": enough}


def _wait_finished(videos: Path, cameras: Sequence[str]) -> None:
    """On a machine with little time to spare, frames are still being encoded when the cameras are closed."""
    end_s = time.monotonic() + _FINISH_S
    while time.monotonic() < end_s and not all((videos / f"{camera}.json").is_file() for camera in cameras):
        time.sleep(_IDLE_S)
    for name, one in read_counts(videos, cameras).items():
        if not one.finished:
            raise InputError(f"{videos.parent.name}: the video of {name} is not complete ({one.fault}); record again")


class _Watch:
    """The loop over the newest frames."""

    def __init__(self, feed: CameraFeed, detector: TargetDetector | None, record: str, step: Step, lenses: bool) -> None:
        self.host = Host(lambda name, values: None, lambda on: None)
        self.guidance: Guidance = new_guidance(feed.cameras)
        self._feed, self._detector, self._record, self._step = feed, detector, record, step
        self._sizes_px: list[list[float]] | None = [[] for _ in feed.cameras] if lenses else None
        self._paces = [Pace(1 / IMAGES_HZ) for _ in feed.cameras]
        self._judged_s = [0.0] * len(feed.cameras)
        self._warnings: dict[str, str] = {}
        self._sizes: dict[str, list[int]] = {}
        self._rates = Rates()
        self._begun_s = time.monotonic()
        self.host.publish("setup", setup_message(scene_setup()), keep=True)

    @property
    def enough(self) -> bool:
        """Whether what is covered is enough for the step."""
        return enough_for(self._step, self.guidance.coverage, self._near_far)

    @property
    def _near_far(self) -> Array | None:
        return None if self._sizes_px is None else near_far_of(self._sizes_px)

    def run(self, *, stop_when_enough: bool) -> None:
        """Until the sources end, enough is covered, or no page shows them; an interrupt ends it, too."""
        pace = Pace(status_pace(True))
        seen_s = time.monotonic()
        while not (stop_when_enough and self.enough):
            seen_s = time.monotonic() if self.host.watched or self._record else seen_s
            if time.monotonic() - seen_s > _UNSEEN_S:
                return
            over = self._feed.over
            self._feed.check()
            for fed in self._feed.newest():
                self._take(fed)
            pace.every_s = status_pace(self.host.watched)
            if pace.due():
                self.host.status(self._status())
            if over:
                return
            time.sleep(_REST_S if self.host.watched or self._detector or self._record else _IDLE_S)

    def _take(self, fed: FedFrame) -> None:
        name, image = self._feed.cameras[fed.camera], fed.frame.image
        self._sizes[name] = list(fed.frame.size_wh)
        now_s = time.monotonic()
        xy: Array = np.zeros((0, 2))
        if self._detector is not None:
            corners = self._detector.detect(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
            xy = corners.xy_img
            if self._sizes_px is not None and np.isfinite(size_px := size_of(xy, corners.patch)):
                self._sizes_px[fed.camera].append(size_px)
            self.guidance = seen(self.guidance, fed.camera, fed.t_ns, xy, fed.frame.size_wh)
        if self.host.watched and now_s - self._judged_s[fed.camera] >= _JUDGE_S:
            self._judged_s[fed.camera] = now_s
            self._warnings[name] = exposure_warning(image) or focus_warning(image)
        if self.host.watched and self._paces[fed.camera].due():
            self.host.publish(f"image {name}", self._packed(fed, xy))

    def _packed(self, fed: FedFrame, xy: Array) -> bytes:
        size = shrunk_wh(fed.frame.size_wh, _SHOWN_PX)
        factor = min(1.0, _SHOWN_PX / max(fed.frame.size_wh))
        small: Any = cv2.resize(fed.frame.image, size, interpolation=cv2.INTER_AREA)
        if self._detector is not None:
            small = coverage_picture(self.guidance.coverage.cells[fed.camera], size, small)
        return image_message(fed.t_ns / 1e9, fed.camera, jpeg_of(small, _QUALITY), size, detected_px=(xy * factor)[None])

    def _status(self) -> dict[str, Any]:
        covered = self.guidance.coverage
        return {
            "cameras": {
                state.camera: {
                    "state": state.state,
                    "text": state.text or self._warnings.get(state.camera, ""),
                    "rate_hz": self._rates.hz(state.camera, state.captured),
                    "missing": state.missing,
                    "size_wh": self._sizes.get(state.camera),
                }
                for state in self._feed.states()
            },
            "target": self._detector is not None,
            "words": advice_for(self._step, covered, self._near_far),
            "enough": self.enough,
            "together": covered.together.tolist(),
            "record": self._record,
            "seconds": time.monotonic() - self._begun_s,
        }
