"""Networks are downloaded before the work begins, announced and with a progress bar."""

from __future__ import annotations

from contextlib import ExitStack

from posefuse.detection.build import DetectorChoice
from posefuse.foundation.plugins import plugin_config

from .terminal import Advance, Terminal


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
