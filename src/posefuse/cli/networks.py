"""Networks are downloaded before the work begins, announced and with a progress bar."""

from __future__ import annotations

from posefuse.detection import downloading
from posefuse.detection.build import DetectorChoice

from .terminal import Terminal


def fetch_networks(choice: DetectorChoice, terminal: Terminal) -> None:
    """Download what the detector needs and does not have, announced and with a bar; raises ModelError when it cannot be had."""
    with terminal.stages() as progress:
        downloading.fetch_networks(choice, progress)
