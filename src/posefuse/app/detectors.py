"""The detector that the settings name, built for this machine and rig."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import field
from typing import Any

from posefuse.app.plugins import build_plugin, plugin_config
from posefuse.app.terminal import Advance, Terminal
from posefuse.core import Detector, Rig
from posefuse.files.settings import settings


@settings
class DetectorChoice:
    """Which detector, and its options (see `posefuse plugins`)."""

    name: str = "blazepose"
    options: dict[str, Any] = field(default_factory=dict)


def build_detector(choice: DetectorChoice, rig: Rig) -> Detector:
    """Build the detector plug-in; one that takes `up_rad` is told where up is in each camera's picture."""
    from posefuse.detect import up_angle_rad

    known = {"up_rad": {camera.name: up_angle_rad(camera) for camera in rig}}
    detector: Detector = build_plugin("detectors", choice.name, choice.options, known)
    return detector


def fetch_networks(choice: DetectorChoice, terminal: Terminal) -> None:
    """Download what the detector needs and does not have, announced and with a bar; raises ModelError when it cannot be had."""
    config = plugin_config("detectors", choice.name, choice.options)
    if not hasattr(config, "fetch"):
        return
    with ExitStack() as stack:
        bars: list[Advance] = []

        def advance(done: int, total: int) -> None:
            if not bars:  # nothing is shown where nothing is missing
                bars.append(stack.enter_context(terminal.progress("downloading networks")))
            bars[0](done, total)

        config.fetch(terminal.note, advance)
