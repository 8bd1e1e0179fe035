"""Camera faults on purpose, to see that a set-up survives them: `posefuse live --fault cam01=freeze@3-6`."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import SE3, Camera, ConfigError, Detections2D, Region, Rig, SourceError
from posefuse.core.errors import choices
from posefuse.sources.arriving import Arrived

FAULTS = ("freeze", "jump", "skew", "bump", "flood", "hang", "unplug")
# about the vertical, to the right, and about the optical axis: as a camera is turned that a person brushes past
_BUMP_RAD = np.deg2rad([0.3, 1.4, 0.3])
_OFF_NS = {"jump": 3600 * 1_000_000_000, "skew": 50_000_000}
_COPIES = 40
_FAR_M = 100.0
_POLL_S = 0.02


@dataclass(frozen=True)
class SourceFault:
    """What goes wrong with a camera, and when.

    Attributes:
        kind: ``freeze`` (the same image again and again), ``jump`` (its clock is an hour ahead),
            ``skew`` (50 ms ahead), ``bump`` (turned by 1.5 degrees), ``flood`` (forty frames for one), ``hang`` (sends nothing),
            ``unplug`` (the source ends, and comes back).
        start_s, end_s: seconds after the session's zero for videos and simulated sessions, after its first opening for a camera.
    """

    kind: str
    start_s: float
    end_s: float


def faults_from_arguments(arguments: Sequence[str], rig: Rig) -> dict[str, tuple[SourceFault, ...]]:
    """Faults by camera of ``CAMERA=KIND@START[-END]``; raises ConfigError for anything else."""
    found: dict[str, tuple[SourceFault, ...]] = {}
    for argument in arguments:
        match = re.fullmatch(r"([^=]+)=([a-z]+)@([0-9.]+)(?:-([0-9.]+))?", argument)
        if not match or match[2] not in FAULTS or match[1] not in rig.names:
            raise ConfigError(
                f"--fault {argument}: expected CAMERA=KIND@START[-END], cameras: {choices(rig.names)}; kinds: {choices(FAULTS)}"
            )
        fault = SourceFault(match[2], float(match[3]), float(match[4]) if match[4] else float("inf"))
        found[match[1]] = (*found.get(match[1], ()), fault)
    return found


@dataclass(frozen=True)
class Wrong:
    """What is wrong with a frame on purpose: its stamp, in ns; and its camera stands elsewhere."""

    off_ns: int = 0
    bumped: bool = False


NOTHING_WRONG = Wrong()


def disturbed(frames: Iterator[Arrived], faults: Sequence[SourceFault], begun_s: float) -> Iterator[tuple[Arrived, Wrong]]:
    """The frames of a faulty camera, and what else is wrong with each; `begun_s`: monotonic time that faults count from."""
    if not faults:
        yield from ((frame, NOTHING_WRONG) for frame in frames)
        return
    last: Arrived | None = None
    for frame in frames:
        active = {fault.kind: fault for fault in faults if fault.start_s <= time.monotonic() - begun_s < fault.end_s}
        if "unplug" in active:
            raise SourceError(f"camera {frame.camera}: unplugged on purpose")
        while "hang" in active and time.monotonic() - begun_s < active["hang"].end_s:
            time.sleep(_POLL_S)
        if "freeze" not in active or last is None:
            last = frame
        off_ns = sum(_OFF_NS.get(kind, 0) for kind in active)
        for copy in range(_COPIES if "flood" in active else 1):
            yield replace(frame, pixels=last.pixels), Wrong(off_ns + copy, "bump" in active)


def bumped(camera: Camera) -> Camera:
    """Where a bump leaves a camera."""
    return replace(camera, cam_from_world=SE3.from_rotvec(_BUMP_RAD, np.zeros(3)) @ camera.cam_from_world)


def seen_by_bumped(view: Detections2D, camera: Camera) -> Detections2D:
    """A view as the camera would have it after a bump: found in the image as it was, so that it needs no image."""
    after = bumped(camera)
    far_world = camera.centre_world + _FAR_M * camera.rays_world(view.xy_img)
    return replace(view, xy_img=after.project(far_world))


def before_bump(region: Region, camera: Camera) -> Region:
    """Where in the image as it was lies what a moved camera is asked to look at."""
    after = bumped(camera)
    far_world = after.centre_world + _FAR_M * after.rays_world(region.centre_img)
    return replace(region, centre_img=camera.project(far_world))
