"""News of a session whose reader has stopped, or has gone."""

import threading

import pytest
from live_session import until

from posefuse.realtime import news
from posefuse.realtime.news import never_waiting


def test_a_reader_that_has_stopped_keeps_no_one_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(news, "_END_S", 0.1)
    goes_on = threading.Event()
    with never_waiting(lambda line: goes_on.wait(60)) as say:
        for i in range(5000):
            say(f"line {i}")
    goes_on.set()


def test_every_line_comes_in_its_order() -> None:
    lines: list[str] = []
    with never_waiting(lines.append) as say:
        for i in range(100):
            say(str(i))
    assert lines == [str(i) for i in range(100)]


def test_a_reader_that_has_gone_ends_what_speaks_to_it() -> None:
    def gone(line: str) -> None:
        raise BrokenPipeError

    def speak_until_it_fails() -> bool:
        say("still there?")
        return False

    with pytest.raises(BrokenPipeError), never_waiting(gone) as say:
        until(speak_until_it_fails)
