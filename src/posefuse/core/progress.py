"""Progress reports of long work; the terminal, a notebook and the browser show them."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Is called whenever there is something to report; must return quickly and may be called often.

    Args (of the call):
        stage: what is being done, e.g. ``detect`` or ``write``; a new name begins a new stage.
        done: steps finished. total: of how many; None where that is not known.
        message: a line of news to show; empty when only the numbers have changed.
    """

    def __call__(self, stage: str, done: int, total: int | None, message: str = "") -> None:
        """Take a report."""
        ...


def silent(stage: str, done: int, total: int | None, message: str = "") -> None:
    """The `Progress` that shows nothing."""
