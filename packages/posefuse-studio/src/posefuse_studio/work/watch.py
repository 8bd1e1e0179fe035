"""Cameras without tracking: images with what is wrong in them, and with a target also what is covered so far; videos on request.

Arguments: ``sources`` by camera name; ``target`` (a target file of the workspace; empty: none);
``record`` (a new folder of the workspace for the videos; empty: none); ``step`` of the calibration that it is for. It ends when
it is cancelled, when its sources end, or, with a target, when enough is covered. What is neither recorded nor shown on any page
gives the cameras free after a while.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.api.calibrate import target_of
from posefuse.api.record import watch
from posefuse.calibration.targets.coverage import coverage_picture
from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.outputs.drawing import jpeg_of, shrunk
from posefuse.realtime.watching import CameraFeed, CameraNews, FedFrame
from posefuse_studio.calibrations import SEEN, SeenTarget, Step, advice_for, enough_for, without_floor
from posefuse_studio.scene_messages import image_message, setup_message
from posefuse_studio.session import STATUS_S, CameraStatus, Host, Pace, SessionStatus
from posefuse_studio.setups import Setup, sources_of_setup
from posefuse_studio.workspace import StudioWorkspace, write_stored

IMAGES_HZ = 15.0
# a page that is loaded again, on a machine that is busy
_UNSEEN_S = 20.0
_SHOWN_PX = 480


def run(arguments: Mapping[str, Any], workspace: StudioWorkspace, progress: Any) -> dict[str, Any]:
    """Watch until the end; see the module."""
    target, record = str(arguments.get("target") or ""), str(arguments.get("record") or "")
    moved = without_floor(target_of(workspace.existing(target))) if target else None
    if record and workspace.path(record).exists():
        raise InputError(f"{record}: exists already; choose another name")
    sources = sources_of_setup(workspace, Setup(sources=dict(arguments["sources"])))
    with watch(sources, target=moved, keep=bool(record), loop_s="shortest") as feed:
        videos = workspace.folder(f"{record}/videos") if record else None
        shown = _Watch(feed, moved is not None, record, arguments.get("step") or "extrinsics")
        progress.listens(shown.host.address)
        # a user who has seen enough ends it: what was recorded is complete then, too
        with suppress(KeyboardInterrupt):
            shown.run(videos)
        enough = shown.enough
        progress("finish the videos", 0, None, "" if enough or not record else "stopped before enough was seen")
    if videos is not None:
        for name, one in feed.counts().items():
            if not one.finished:
                raise InputError(f"{record}: the video of {name} is not complete ({one.fault}); record again")
        write_stored(workspace.path(record) / SEEN, SeenTarget(target=target, enough=enough))
    return {"record": record, "enough": enough}


class _Watch:
    """The loop over the newest frames."""

    def __init__(self, feed: CameraFeed, guided: bool, record: str, step: Step) -> None:
        self.host = Host()
        self._feed, self._guided, self._record, self._step = feed, guided, record, step
        self._paces = [Pace(1 / IMAGES_HZ) for _ in feed.cameras]
        self._news: tuple[CameraNews, ...] = ()
        self._sizes: dict[str, tuple[int, int]] = {}
        self._begun_s = time.monotonic()
        self.host.publish("setup", setup_message(), keep=True)

    @property
    def enough(self) -> bool:
        """Whether what is covered is enough for the step."""
        return enough_for(self._step, self._feed.guidance.coverage)

    def run(self, videos: Path | None) -> None:
        """Until the sources end, enough of a target is covered, or no page shows them; an interrupt ends it, too."""
        pace, seen_s = Pace(STATUS_S), time.monotonic()
        for frames, news in self._feed.watched(videos, judged=True):
            self._news = news or self._news
            for fed in frames:
                self._take(fed)
            if pace.due():
                self.host.status(self._status())
            seen_s = time.monotonic() if self.host.watched or self._record else seen_s
            if time.monotonic() - seen_s > _UNSEEN_S or (self._guided and self.enough):
                return

    def _take(self, fed: FedFrame) -> None:
        name = self._feed.cameras[fed.camera]
        self._sizes[name] = fed.frame.size_wh
        xy: Array = np.zeros((0, 2)) if fed.corners is None else fed.corners.xy_img
        if self.host.watched and self._paces[fed.camera].due():
            self.host.publish(f"image {name}", self._packed(fed, xy))

    def _packed(self, fed: FedFrame, xy: Array) -> bytes:
        small = shrunk(fed.frame.image, _SHOWN_PX)
        size = small.shape[1], small.shape[0]
        if self._guided:
            small = coverage_picture(self._feed.guidance.coverage.cells[fed.camera], size, small)
        factor = min(1.0, _SHOWN_PX / max(fed.frame.size_wh))
        return image_message(fed.t_ns / 1e9, fed.camera, jpeg_of(small), size, detected_px=(xy * factor)[None])

    def _status(self) -> SessionStatus:
        covered = self._feed.guidance.coverage
        return SessionStatus(
            cameras={one.camera: self._camera(one) for one in self._news},
            recording=self._record,
            seconds=time.monotonic() - self._begun_s,
            words=advice_for(self._step, covered),
            enough=self.enough,
        )

    def _camera(self, now: CameraNews) -> CameraStatus:
        size_wh = self._sizes.get(now.camera)
        figures = [
            *(["x".join(map(str, size_wh))] if size_wh else []),
            f"{now.rate_hz:.0f}/s",
            *([f"{now.missing} lost"] if now.missing else []),
        ]
        return CameraStatus(
            light="bad" if now.state in ("lost", "ended") else "doubt" if now.warning else "good",
            state=now.state,
            text=now.warning,
            figures=", ".join(figures),
            size_wh=size_wh,
        )
