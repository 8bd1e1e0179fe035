"""Messages that an output must have seen before all others, for one that is opened later than the session."""

from __future__ import annotations

from posefuse.core import LiveJointCentres, LiveMessage


class KeptMessages:
    """The newest `LiveJointCentres` of each set of cameras, in the order they came."""

    def __init__(self) -> None:
        self._centres: dict[tuple[str, ...], LiveJointCentres] = {}

    def keep(self, message: LiveMessage) -> None:
        """Remember it if it is one of those."""
        if isinstance(message, LiveJointCentres):
            self._centres.pop(message.cameras, None)
            self._centres[message.cameras] = message

    def messages(self) -> list[LiveMessage]:
        """What to hand on first."""
        return list(self._centres.values())
