"""The detector of a camera process, whose network can be exchanged while frames continue being processed."""

from __future__ import annotations

import threading

from posefuse.core import Detector, PosefuseError, Rig
from posefuse.detection.build import DetectorChoice, build_detector

from .networks import with_network


class ChangeableDetector:
    """Builds another network in a thread of its own and exchanges it between two frames.

    Attributes:
        now: the detector in use. network: the name of its bundled network; empty when the settings chose none.
    """

    def __init__(self, choice: DetectorChoice, rig: Rig) -> None:
        self._choice, self._rig = choice, rig
        self.now: Detector = build_detector(choice, rig)
        self.network = str(choice.options.get("landmarks", ""))
        self._loaded: tuple[str, Detector | None] | None = None
        self._loading = ""

    def load(self, network: str) -> None:
        """Begin to load another network; nothing happens when that one is in use, or another is being loaded."""
        if network != self.network and not self._loading:
            self._loading = network
            threading.Thread(target=self._build, args=(network,), name=f"load {network}", daemon=True).start()

    def exchanged(self) -> bool:
        """Whether a network that has been loaded is in use from now on."""
        if self._loaded is None:
            return False
        (name, detector), self._loaded, self._loading = self._loaded, None, ""
        if detector is None:
            return False
        self.network, self.now = name, detector
        return True

    def _build(self, network: str) -> None:
        try:
            self._loaded = network, build_detector(with_network(self._choice, network), self._rig)
        except PosefuseError:
            # the one in use continues; it is asked for again with the next status
            self._loaded = network, None
