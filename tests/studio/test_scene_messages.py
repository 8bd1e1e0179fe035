"""Binary messages, read back as the page does; newest wins: a slow page misses messages and delays no other."""

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from studio_messages import read_message

from posefuse_studio.scene_messages import ellipsoid_factors, image_message, page_message, poses_message
from posefuse_studio.state import Stream
from posefuse_studio.work.live import nearest_pose


def test_poses_are_read_back() -> None:
    rng = np.random.default_rng(1)
    xyz = rng.normal(size=(2, 5, 3))
    xyz[1, 3] = np.nan
    root = rng.normal(size=(2, 5, 3, 3)) * 0.01
    cov = root @ np.swapaxes(root, -1, -2)
    read = read_message(poses_message(2.5, np.array([4, 9]), xyz, cov, rgba=[(1, 2, 3, 255), (0, 0, 0, 0)]))
    assert (read["kind"], read["t_s"], read["people"], read["keypoints"], read["ids"]) == ("poses", 2.5, 2, 5, [4, 9])
    assert read["rgba"] == [[1, 2, 3, 255], [0, 0, 0, 0]]
    np.testing.assert_allclose(read["xyz"].reshape(2, 5, 3), xyz, rtol=1e-6)
    shape = read["shapes"].reshape(2, 5, 3, 3).astype(float)
    np.testing.assert_allclose(shape @ np.swapaxes(shape, -1, -2), 4 * cov, rtol=1e-4, atol=1e-9)
    assert read["file"] == b""
    plain = read_message(poses_message(0.0, np.array([1, 2]), xyz))
    assert "shapes" not in plain and plain["rgba"] == [[0, 0, 0, 0]] * 2


@pytest.mark.parametrize("text", ["", "a", "ab", "abc", "ü"])
def test_arrays_begin_where_a_page_can_read_them(text: str) -> None:
    raw = page_message("values", {"values": np.ones(3)}, text=text)
    assert int.from_bytes(raw[:4], "little") % 4 == 0 and read_message(raw)["text"] == text


@pytest.mark.parametrize("bad", [np.full((3, 3), np.nan), np.eye(3) * 4.0, np.diag([1e-4, 1e-4, 0.0])])
def test_a_huge_covariance_is_not_drawn(bad: np.ndarray) -> None:
    shape = ellipsoid_factors(np.stack([bad, np.eye(3) * 1e-4]))
    assert np.isnan(shape[0]).all() and np.isfinite(shape[1]).all()


def test_a_covariance_with_a_flat_direction_is_drawn_all_the_same() -> None:
    flat = np.outer([0.01, 0.02, 0.03], [0.01, 0.02, 0.03])
    shape = ellipsoid_factors(flat)
    np.testing.assert_allclose(shape @ shape.T, 4 * flat, atol=1e-7)


def test_images_carry_what_is_drawn_over_them() -> None:
    seen, fused = np.arange(12.0).reshape(2, 3, 2), np.full((1, 3, 2), 7.0)
    read = read_message(image_message(1.0, 3, b"JPEG", (320, 240), detected_px=seen, projected_px=fused, rgba=[(9, 8, 7, 255)]))
    assert (read["kind"], read["t_s"], read["rgba"], read["file"]) == ("image", 1.0, [[9, 8, 7, 255]], b"JPEG")
    names = ("camera", "width", "height", "detections", "people", "keypoints")
    assert [read[name] for name in names] == [3, 320, 240, 2, 1, 3]
    np.testing.assert_array_equal(read["seen"].reshape(2, 3, 2), seen)
    np.testing.assert_array_equal(read["fused"].reshape(1, 3, 2), fused)
    nothing = np.zeros((0, 3, 2))
    for one in (None, nothing):
        empty = read_message(image_message(1.0, 0, b"JPEG", (1, 1), detected_px=one, projected_px=one))
        assert [empty[name] for name in names[3:]] == [0, 0, 0] and empty["file"] == b"JPEG"


# --- streams: what stays is given to pages that come later


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
