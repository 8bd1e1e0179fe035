"""Messages that an output must have seen before all others, for one that is opened later than the session."""

from __future__ import annotations

from collections.abc import Iterable

from posefuse.core import LiveJointCentres, LiveMessage, LiveNames


class KeptMessages:
    """The newest `LiveJointCentres` of each set of cameras, in the order they came, and the newest `LiveNames`."""

    def __init__(self, messages: Iterable[LiveMessage] = ()) -> None:
        self._centres: dict[tuple[str, ...], LiveJointCentres] = {}
        self._names: LiveNames | None = None
        for message in messages:
            self.keep(message)

    def keep(self, message: LiveMessage) -> bool:
        """Remember it if it is one of those; whether it is."""
        if isinstance(message, LiveJointCentres):
            self._centres.pop(message.cameras, None)
            self._centres[message.cameras] = message
        elif isinstance(message, LiveNames):
            self._names = message
        else:
            return False
        return True

    def messages(self) -> list[LiveMessage]:
        """What to hand on first."""
        return [*self._centres.values(), *([self._names] if self._names is not None else [])]
