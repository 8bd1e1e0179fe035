"""Cameras that are only looked at are given free when no page shows them."""

import time

import pytest

from posefuse.realtime.capture import LiveInput
from posefuse.realtime.watching import CameraFeed
from posefuse_studio.work import watch

SOON_S = 0.2


class Feed(CameraFeed):
    """Cameras that give no frame and never end."""

    over = False

    def __init__(self) -> None:
        super().__init__([LiveInput(name, "none", None, reopen=True) for name in ("a", "b")])
        self.checks = 0

    def check(self) -> None:
        """Counts as a round of the loop."""
        self.checks += 1

    begin = close = lambda *_: None
    # of a machine so slow that news of the cameras are due
    newest = states = came = lambda self: []


def watched(record: str, rounds: int, monkeypatch: pytest.MonkeyPatch) -> Feed:
    """Cameras that are looked at until that ends, on a page that is shown in so many rounds of the loop."""
    monkeypatch.setattr(watch, "_UNSEEN_S", SOON_S)
    feed = Feed()
    one = watch._Watch(feed, False, record, "extrinsics")
    shown = property(lambda _: feed.checks < rounds)
    one.host = type("Host", (), {"watched": shown, "status": lambda self, values: None})()
    one.run(None)
    return feed


def test_images_that_no_page_shows_end(monkeypatch: pytest.MonkeyPatch) -> None:
    begun_s = time.monotonic()
    feed = watched("", 100, monkeypatch)
    # a page that shows them keeps them
    assert feed.checks > 100 and time.monotonic() - begun_s > SOON_S


def test_a_recording_continues_without_a_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Feed, "over", property(lambda feed: feed.checks > 100))
    assert watched("calibrations/room/verify-1", 0, monkeypatch).checks > 100
