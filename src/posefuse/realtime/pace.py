"""Whether this machine keeps up with its cameras, in words for the user."""

from __future__ import annotations

from .messages import Status

# a sentence is due when a smaller share of the images is processed over this time
LEAST_SHARE, _OVER_S = 0.5, 10.0
# that see a person, before it has a place
LEAST_CAMERAS = 2


class ProcessedImages:
    """How many of the images that the cameras deliver are processed; frames of a process that starts again count on."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[int, int]] = {}
        self._came = self._used = 0
        self._since: tuple[float, int, int] | None = None
        self._reported = False

    def news(self, status: Status, now_s: float, network: str) -> str:
        """Take in what a process reports at a time: the sentence about a machine that is too slow, once; else empty."""
        for state in status.cameras:
            captured, used = self._last.get(state.camera, (0, 0))
            self._came += state.captured - captured if state.captured >= captured else state.captured
            self._used += state.used - used if state.used >= used else state.used
            self._last[state.camera] = state.captured, state.used
        if self._since is None:
            self._since = now_s, self._came, self._used
        began_s, came, used = self._since
        if now_s - began_s < _OVER_S:
            return ""
        share = (self._used - used) / max(self._came - came, 1)
        slow = self._came > came and share < LEAST_SHARE
        self._since = now_s, self._came, self._used
        if not slow or self._reported:
            return ""
        self._reported = True
        smaller = "" if network.endswith("lite") else "`networks=blazepose_lite`, "
        return f"this computer processes {share:.0%} of the images: use {smaller}fewer cameras, or cameras at a lower frame rate"
