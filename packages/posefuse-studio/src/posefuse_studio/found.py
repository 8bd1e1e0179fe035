"""What there is to see with: cameras of this machine, videos and scenes of the workspace."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from posefuse.core import PosefuseError
from posefuse.foundation.platform import usb_cameras
from posefuse.foundation.plugins import from_package

from .calibrations import FOLDER
from .workspace import StudioWorkspace

VIDEOS = (".mp4", ".mkv", ".mov", ".avi", ".webm")


@dataclass(frozen=True, kw_only=True)
class Found:
    """One source: its words for people, as it is written for ``--source``, and a name to start with."""

    text: str
    source: str
    name: str
    icon: str


def found_sources(workspace: StudioWorkspace) -> Iterator[Found]:
    """Devices first, then videos and scenes of the workspace; without what a calibration has recorded."""
    for number, (device, text) in enumerate(usb_cameras().items(), 1):
        yield Found(text=f"{text} ({device})", source=f"usb:{device}", name=f"cam{number}", icon="videocam")
    for name in workspace.files(*VIDEOS):
        if not name.startswith(f"{FOLDER}/"):
            yield Found(text=name, source=f"video:{name}", name=Path(name).stem[:40], icon="movie")
    for name in workspace.files(".yaml", ".yml"):
        # some are other files
        with suppress(PosefuseError):
            for camera in from_package("sources", "simulated", extra="sim").cameras(workspace.existing(name)):
                yield Found(text=f"{name}: {camera}", source=f"sim:{name}", name=camera, icon="view_in_ar")
