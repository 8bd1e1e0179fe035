"""A server's side of a session: what no page shows is not sent, and what is damaged is noted."""

import asyncio
import itertools
import os
import pickle
from collections.abc import Callable, Coroutine
from multiprocessing.connection import Client
from socket import SHUT_RDWR, socket
from types import SimpleNamespace
from typing import Any, ClassVar
from unittest.mock import Mock

import pytest
from live_session import until
from nicegui.binding import bind_from

from posefuse.core import OutputHealth
from posefuse_studio.jobs import Job
from posefuse_studio.session import CameraStatus, Host, SessionStatus
from posefuse_studio.state import LiveLink
from posefuse_studio.workspace import SessionAddress

STATUS = SessionStatus(people=[3])


class OneJob:
    """The jobs of a workspace in which one session runs."""

    def __init__(self, host: Host) -> None:
        self._address = host.address
        self.over = False

    def running(self, work: str) -> list[Job]:
        return [] if self.over else [Job(id="1", work=work, title="", arguments={}, begun_s=0.0)]

    def address(self, job: str) -> SessionAddress:
        return self._address


@pytest.fixture
def host() -> Host:
    return Host()


def in_loop(link: LiveLink, use: Callable[[], Coroutine[Any, Any, None]]) -> None:
    async def main() -> None:
        link.begin(asyncio.get_running_loop())
        await use()

    asyncio.run(main())


def test_a_session_receives_what_pages_show(host: Host) -> None:
    link = LiveLink(OneJob(host))

    async def use() -> None:
        await asyncio.to_thread(until, lambda: link._connection is not None)
        assert not host.watched
        link.stream._pages.add(Mock())
        link.stream._on_watched(len(link.stream._pages))
        await asyncio.to_thread(until, lambda: host.watched)
        host.publish("setup", b"scene", keep=True)
        await asyncio.to_thread(until, lambda: link.stream._kept)
        assert link.stream._kept == {"setup": b"scene"}
        link.stream._pages.clear()
        link.stream._on_watched(len(link.stream._pages))
        await asyncio.to_thread(until, lambda: not host.watched)

    in_loop(link, use)


def test_the_state_of_a_session_is_pushed_to_the_pages_and_ends_with_it(host: Host) -> None:
    jobs = OneJob(host)
    link = LiveLink(jobs)
    host.status(STATUS)

    async def use() -> None:
        label = SimpleNamespace(text="")
        bind_from(label, "text", link, "status", lambda now: str(now.people))
        assert (link.job, link.status, label.text) == (None, SessionStatus(), "[]")
        link.begin(asyncio.get_running_loop())
        await asyncio.to_thread(until, lambda: label.text == "[3]")
        assert link.job is not None
        jobs.over = True
        with socket(fileno=os.dup(host._watchers[0]._connection.fileno())) as ended:
            ended.shutdown(SHUT_RDWR)
        await asyncio.to_thread(until, lambda: link.status == SessionStatus() and link.job is None)
        assert label.text == "[]"

    asyncio.run(use())


class Trap:
    """Runs something when it is unpickled."""

    ran: ClassVar[list[bool]] = []

    def __reduce__(self) -> Any:
        return Trap.ran.append, (True,)


@pytest.mark.parametrize(
    "damaged",
    [
        pickle.dumps((True, "status", Trap())), b"", b"\n", b"{", b"[1, 2]\n", b'[true, "status"]\n', b"\xff" * 9,
        b'[true, "status"]\n{"cameras": {"a": {"state": 5}}}', b'[true, "status"]\n{"people": 3}', b'["run", "a"]\nx',
        b'[true, {}]\n',
    ],
)  # fmt: skip
def test_a_damaged_message_is_noted_and_the_next_one_taken(host: Host, damaged: bytes, caplog: pytest.LogCaptureFixture) -> None:
    link = LiveLink(OneJob(host))

    async def use() -> None:
        await asyncio.to_thread(until, lambda: host._watchers)
        host._watchers[0]._connection.send_bytes(damaged)
        host.status(STATUS)
        await asyncio.to_thread(until, lambda: link.status.people)
        assert link.status.people == [3] and Trap.ran == []

    in_loop(link, use)
    assert "damaged message" in caplog.text


def test_a_stranger_at_the_port_or_a_fault_does_not_end_the_link(host: Host, caplog: pytest.LogCaptureFixture) -> None:
    jobs = OneJob(host)
    good = jobs.address("1")
    faults = [RuntimeError("a fault"), SessionAddress(port=good.port, key=b"another key")]
    jobs.address = Mock(side_effect=itertools.chain(faults, itertools.repeat(good)))
    link = LiveLink(jobs)
    host.status(STATUS)
    in_loop(link, lambda: asyncio.to_thread(until, lambda: link.status.people))
    assert "a fault" in caplog.text and "AuthenticationError" in caplog.text


def test_a_damaged_request_does_not_end_the_session_or_the_next_request() -> None:
    asked: list[str] = []
    host = Host({"record": lambda name: asked.append(name)})
    with Client(("127.0.0.1", host.address.port), authkey=host.address.key) as server:
        damaged = (
            pickle.dumps(("record", Trap())),
            b"{",
            b'["record"]',
            b'["record", {}]',
            b'["watch", {}]',
            b'["watch", {"on": []}]',
        )
        for raw in (*damaged, b'["record", {"name": "walk"}]'):
            server.send_bytes(raw)
        until(lambda: asked)
    assert asked == ["walk"] and Trap.ran == []


def test_a_status_goes_through_whole(host: Host) -> None:
    camera = CameraStatus(light="good", state="ok", figures="30/s, 2 dropped", size_wh=(640, 480))
    outputs = {"osc": OutputHealth(state="failed", text="no route", where="h:1", taken=3)}
    status = SessionStatus(cameras={"a": camera}, latency_p95_ms=17.5, outputs=outputs, wanted=["osc"])
    link = LiveLink(OneJob(host))
    host.status(status)
    in_loop(link, lambda: asyncio.to_thread(until, lambda: link.status == status))
