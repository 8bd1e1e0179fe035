"""What there is to see with: cameras of this machine, videos and scenes of the workspace."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from .workspace import StudioWorkspace

VIDEOS = (".mp4", ".mkv", ".mov", ".avi", ".webm")
_V4L = Path("/sys/class/video4linux")


@dataclass(frozen=True, kw_only=True)
class Found:
    """One source: its words for people, as it is written for ``--source``, and a name to start with."""

    text: str
    source: str
    name: str
    icon: str


def found_sources(workspace: StudioWorkspace) -> list[Found]:
    """Devices first, then videos and scenes of the workspace."""
    return [*_devices(), *_videos(workspace), *_scenes(workspace)]


def _devices() -> list[Found]:
    """USB cameras. On Linux, each has several nodes; the one that gives images has index 0."""
    if sys.platform != "linux" or not _V4L.is_dir():
        return []
    found: list[Found] = []
    for node in sorted(_V4L.iterdir()):
        try:
            index, text = (node / "index").read_text().strip(), (node / "name").read_text().strip()
        except OSError:
            continue
        if index == "0":
            found.append(
                Found(text=f"{text} ({node.name})", source=f"usb:/dev/{node.name}", name=f"cam{len(found) + 1}", icon="videocam")
            )
    return found


def _videos(workspace: StudioWorkspace) -> list[Found]:
    """Not those that a calibration has filmed."""
    names = [name for name in workspace.files(*VIDEOS) if not name.startswith("calibrations/")]
    return [Found(text=name, source=f"video:{name}", name=Path(name).stem[:40], icon="movie") for name in names]


def _scenes(workspace: StudioWorkspace) -> list[Found]:
    from posefuse.core import PosefuseError
    from posefuse.foundation.plugins import from_package

    found = []
    for name in workspace.files(".yaml", ".yml"):
        try:
            cameras = from_package("sources", "simulated", extra="sim").cameras(workspace.existing(name))
        except PosefuseError:
            # some other file
            continue
        found += [Found(text=f"{name}: {camera}", source=f"sim:{name}", name=camera, icon="view_in_ar") for camera in cameras]
    return found
