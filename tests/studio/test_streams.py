"""Newest wins: a slow page misses messages and delays no other; what stays is given to pages that come later."""

import asyncio
from types import SimpleNamespace
from typing import Any

from posefuse_studio.state import Stream
from posefuse_studio.work.live import nearest_pose


class Page:
    """A websocket whose page takes messages only while it is `open`."""

    def __init__(self) -> None:
        self.taken: list[bytes] = []
        self.open, self.gone = asyncio.Event(), asyncio.Event()

    async def send_bytes(self, message: bytes) -> None:
        await asyncio.wait_for(self.open.wait(), 30.0)
        self.taken.append(message)

    async def receive(self) -> dict[str, Any]:
        await asyncio.wait_for(self.gone.wait(), 30.0)
        return {"type": "websocket.disconnect"}


async def settle() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


def test_the_newest_of_each_key_reaches_a_slow_page() -> None:
    async def scenario() -> None:
        stream, slow, quick = Stream(), Page(), Page()
        quick.open.set()
        tasks = [asyncio.create_task(stream.serve(page)) for page in (slow, quick)]
        await settle()
        for number in range(5):
            stream.publish("pose", b"pose %d" % number)
            stream.publish("image", b"image %d" % number)
            await settle()
        assert len(quick.taken) == 10
        slow.open.set()
        await settle()
        # the first was on its way already
        assert slow.taken == [b"pose 0", b"image 4", b"pose 4"]
        for page in (slow, quick):
            page.gone.set()
        await asyncio.gather(*tasks)

    asyncio.run(scenario())


def test_a_page_that_comes_later_gets_what_stays_and_is_counted() -> None:
    async def scenario() -> None:
        counts: list[int] = []
        stream, page = Stream(counts.append), Page()
        page.open.set()
        stream.publish("setup", b"old", keep=True)
        stream.publish("setup", b"setup", keep=True)
        stream.publish("pose", b"gone")
        assert not stream.watched
        task = asyncio.create_task(stream.serve(page))
        await settle()
        assert page.taken == [b"setup"] and stream.watched
        page.gone.set()
        await task
        assert counts == [1, 0] and not stream.watched

    asyncio.run(scenario())


def test_an_image_shows_the_pose_of_its_own_time() -> None:
    past: Any = [SimpleNamespace(t_ns=t_ns) for t_ns in (10, 20, 30)]
    assert [nearest_pose(past, t_ns).t_ns for t_ns in (0, 14, 16, 99)] == [10, 10, 20, 30]
    assert nearest_pose([], 5) is None
