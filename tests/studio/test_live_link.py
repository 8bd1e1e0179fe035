"""A server's side of a session: what no page shows is not sent, and without a page it does not even look for sessions."""

import asyncio
import pickle
import time
from collections.abc import Callable, Coroutine
from multiprocessing.connection import Client
from pathlib import Path
from typing import Any, ClassVar

import pytest

from posefuse_studio import live_host, live_link
from posefuse_studio.access import Access
from posefuse_studio.jobs import Job
from posefuse_studio.live_host import Host
from posefuse_studio.live_link import LiveLink
from posefuse_studio.private_files import SessionAddress
from posefuse_studio.session_messages import LIVE, WATCH, DamagedMessage, packed_request, packed_status, unpacked_status
from posefuse_studio.state import Studio
from posefuse_studio.workspace import StudioWorkspace

STATUS: dict[str, Any] = {
    "cameras": {}, "sizes": {}, "outputs": {}, "wanted": {}, "people": [], "names": {}, "person": None, "plots": [],
    "latency_p95_ms": 1.0, "recording": None, "news": [], "refused": [],
}  # fmt: skip


class OneJob:
    """The jobs of a workspace in which one session runs."""

    def __init__(self, host: Host) -> None:
        self._address = host.address
        self.looks = 0

    def running(self, work: str) -> list[Job]:
        self.looks += 1
        return [Job(id="1", work=work, title="", arguments={}, begun_s=0.0)]

    def address(self, job: str) -> SessionAddress:
        return self._address


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
        assert not host.watched
        link.stream._subscribers.add(Page())  # type: ignore[arg-type]
        link.stream._report_subscribers()
        await asyncio.to_thread(until, lambda: host.watched)
        host.publish("setup", b"scene", keep=True)
        await asyncio.to_thread(until, lambda: link.stream._kept)
        assert link.stream._kept == {"setup": b"scene"}
        link.stream._subscribers.clear()
        link.stream._report_subscribers()
        await asyncio.to_thread(until, lambda: not host.watched)

    in_loop(link, use)


def test_it_looks_only_while_there_are_pages(host: Host) -> None:
    jobs = OneJob(host)
    link = LiveLink(jobs)  # type: ignore[arg-type]
    host.status(STATUS | {"people": [3]})

    async def use() -> None:
        assert (jobs.looks, link.job, link.status) == (0, None, {})
        link.awake(True)
        await asyncio.to_thread(link.wait_looked)
        assert jobs.looks == 1 and link.job is not None and link.status == STATUS | {"people": [3]}
        link.awake(False)
        # what the session sends next ends the connection
        host.status(STATUS | {"people": [4]})
        await asyncio.to_thread(until, lambda: not host._watchers)
        await asyncio.to_thread(until, lambda: not link._looked.is_set())
        assert jobs.looks == 1
        link.awake(True)
        await asyncio.to_thread(link.wait_looked)
        assert jobs.looks == 2 and link.status == STATUS | {"people": [4]}

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


class Trap:
    """Runs something when it is unpickled."""

    ran: ClassVar[list[bool]] = []

    def __reduce__(self) -> Any:
        return Trap.ran.append, (True,)


@pytest.mark.parametrize(
    "damaged",
    [
        pickle.dumps(("status", "", Trap())), b"", b"\n", b"{", b"[1, 2]\n", b'["status", ""]\n', b"\xff" * 9,
        b'["status", ""]\n{"cameras": {"a": {"state": 5}}}', b'["run", "a"]\nx', b'["stream", {}]\n',
    ],
)  # fmt: skip
def test_a_damaged_message_is_noted_and_the_next_one_taken(host: Host, damaged: bytes, caplog: pytest.LogCaptureFixture) -> None:
    link = LiveLink(OneJob(host))  # type: ignore[arg-type]

    async def use() -> None:
        link.awake(True)
        await asyncio.to_thread(until, lambda: host._watchers)
        host._watchers[0]._connection.send_bytes(damaged)
        host.status(STATUS | {"people": [3]})
        await asyncio.to_thread(until, lambda: link.status)
        assert link.status["people"] == [3] and Trap.ran == []

    in_loop(link, use)
    assert "damaged message" in caplog.text


def test_a_stranger_at_the_port_or_a_fault_does_not_end_the_link(host: Host, caplog: pytest.LogCaptureFixture) -> None:
    jobs = OneJob(host)
    good = jobs.address("1")
    faults: list[Any] = [RuntimeError("a fault"), SessionAddress(port=good.port, key=b"another key"), good]

    def address(job: str) -> SessionAddress:
        now = faults.pop(0) if len(faults) > 1 else faults[0]
        if isinstance(now, Exception):
            raise now
        return now

    jobs.address = address  # type: ignore[method-assign]
    link = LiveLink(jobs)  # type: ignore[arg-type]
    host.status(STATUS)

    async def use() -> None:
        link.awake(True)
        await asyncio.to_thread(until, lambda: link.status)

    in_loop(link, use)
    assert "a fault" in caplog.text and "AuthenticationError" in caplog.text


def test_a_damaged_request_does_not_end_the_session_or_the_next_request() -> None:
    asked: list[str] = []
    host = Host(lambda name, values: asked.append(values["name"]), lambda on: None)
    with Client(("127.0.0.1", host.address.port), authkey=host.address.key) as server:
        for raw in (
            pickle.dumps(("record", Trap())),
            b"{",
            b'["record"]',
            b'["record", {}]',
            b'["watch", {}]',
            b'["watch", {"on": []}]',
        ):
            server.send_bytes(raw)
        server.send_bytes(packed_request("record", {"name": "walk"}))
        until(lambda: asked)
    assert asked == ["walk"] and Trap.ran == []


def test_a_status_goes_through_whole(host: Host) -> None:
    camera = {"state": "ok", "text": "", "rate_hz": 30.0, "replaced": 2.0}
    status = STATUS | {"cameras": {"a": camera}, "names": {3: "Ada"}, "latency_p95_ms": 17.5, "sizes": {"a": (640, 480)}}
    assert unpacked_status(LIVE, packed_status(status)) == status
    with pytest.raises(DamagedMessage, match="cameras"):
        unpacked_status(LIVE, packed_status({**status, "cameras": {"a": 3}}))
    with pytest.raises(DamagedMessage):
        unpacked_status(WATCH, packed_status(status))


def test_nothing_between_session_and_server_is_pickled() -> None:
    """Only bytes go over the connection: `send` and `recv` of it are pickles."""
    for module in (live_host, live_link):
        source = Path(module.__file__ or "").read_text(encoding="utf-8")
        assert "send_bytes(" in source and ".send(" not in source and ".recv(" not in source and "pickle" not in source
