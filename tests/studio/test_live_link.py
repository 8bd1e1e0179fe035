"""A server's side of a session: what no page shows is not sent, and without a page it does not even look for sessions."""

import asyncio
import time
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from posefuse.studio.access import Access
from posefuse.studio.jobs import Job, Report
from posefuse.studio.live_host import BODIES, SCENE, Host
from posefuse.studio.live_link import LiveLink
from posefuse.studio.state import Studio
from posefuse.studio.workspace import StudioWorkspace


class OneJob:
    """The jobs of a workspace in which one session runs."""

    def __init__(self, host: Host) -> None:
        self._address = host.address
        self.looks = 0

    def running(self, work: str) -> list[Job]:
        self.looks += 1
        return [Job(id="1", work=work, title="", arguments={}, begun_s=0.0)]

    def report(self, job: str) -> Report:
        return Report(extra={"address": self._address})


class Page:
    """Counts as one that shows a stream."""

    def put(self, key: object, message: bytes) -> None:
        """Nothing."""


def until(condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.fixture
def host() -> Host:
    return Host(lambda name, values: None, lambda on: None)


def in_loop(link: LiveLink, use: Callable[[], Coroutine[Any, Any, None]]) -> None:
    async def main() -> None:
        link.begin(asyncio.get_running_loop())
        await use()

    asyncio.run(main())


def test_a_session_receives_what_pages_show(host: Host) -> None:
    link = LiveLink(OneJob(host))  # type: ignore[arg-type]

    async def use() -> None:
        link.awake(True)
        await asyncio.to_thread(until, lambda: link._connection is not None)
        page = Page()
        for stream in (link.stream, link.bodies):
            stream._subscribers.add(page)  # type: ignore[arg-type]
            stream._report_subscribers()
        await asyncio.to_thread(until, lambda: host.wanted(SCENE) and host.wanted(BODIES))
        host.publish("mesh", b"kept", keep=True, channel=BODIES)
        host.publish("pose", b"scene", keep=True)
        await asyncio.to_thread(until, lambda: link.bodies._kept and link.stream._kept)
        assert (link.bodies._kept, link.stream._kept) == ({"mesh": b"kept"}, {"pose": b"scene"})
        link.bodies._subscribers.clear()
        link.bodies._report_subscribers()
        await asyncio.to_thread(until, lambda: not host.wanted(BODIES))
        assert host.watched

    in_loop(link, use)


def test_it_looks_only_while_there_are_pages(host: Host) -> None:
    jobs = OneJob(host)
    link = LiveLink(jobs)  # type: ignore[arg-type]
    host.status({"people": [3]})

    async def use() -> None:
        assert (jobs.looks, link.job, link.status) == (0, None, {})
        link.awake(True)
        await asyncio.to_thread(link.wait_looked)
        assert jobs.looks == 1 and link.job is not None and link.status == {"people": [3]}
        link.awake(False)
        # what the session sends next ends the connection
        host.status({"people": [4]})
        await asyncio.to_thread(until, lambda: not host._watchers)
        await asyncio.to_thread(until, lambda: not link._looked.is_set())
        assert jobs.looks == 1
        link.awake(True)
        await asyncio.to_thread(link.wait_looked)
        assert jobs.looks == 2 and link.status == {"people": [4]}

    in_loop(link, use)


def test_a_studio_looks_until_its_last_page_has_gone(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    studio = Studio.of(StudioWorkspace(tmp_path), Access.of("127.0.0.1", 1))
    said: list[bool] = []
    for link in (studio.live, studio.watch):
        monkeypatch.setattr(link, "awake", said.append)
        monkeypatch.setattr(link, "wait_looked", lambda: None)
    asyncio.run(studio.came("one"))
    asyncio.run(studio.came("two"))
    said.clear()
    studio.left("one")
    assert said == [True, True]
    studio.left("two")
    assert said[2:] == [False, False]
