"""Networks are downloaded before the work begins, with a message and with progress."""

from __future__ import annotations

from posefuse.core import Progress, silent
from posefuse.foundation.plugins import plugin_config

from .build import DetectorChoice

STAGE = "downloading networks"


def fetch_networks(choice: DetectorChoice, progress: Progress = silent) -> None:
    """Download the networks that the detector needs and does not have.

    Raises:
        ModelError: a network cannot be downloaded.
    """
    config = plugin_config("detectors", choice.name, choice.options)
    if hasattr(config, "fetch"):
        config.fetch(lambda text: progress(STAGE, 0, None, text), lambda done, total: progress(STAGE, done, total))
