"""RealSense cameras, with a module like the maker's (names and units of pyrealsense2 2.59)."""

import sys
import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from checks import refusal

from posefuse.core import DependencyError, SourceError
from posefuse.sources.live import RealSenseConfig

EXPOSED_NS, READ_NS = 4_000_000, 9_000_000
SHAPE = (48, 64, 3)


class Ended(RuntimeError):
    """What the makers' libraries raise, under no name of their own."""


class Exposures:
    """Images whose exposure had its middle EXPOSED_NS + READ_NS before they are handed over."""

    def __init__(self, count: int = 5) -> None:
        self.middles_ns: list[int] = []
        self._count = count

    def next(self) -> tuple[int, np.ndarray]:
        if len(self.middles_ns) == self._count:
            raise Ended("Frame did not arrive in time!")
        image = np.full(SHAPE, len(self.middles_ns), np.uint8)
        self.middles_ns.append(time.time_ns() - EXPOSED_NS - READ_NS)
        return self.middles_ns[-1], image


def gives(**answers: Any) -> SimpleNamespace:
    """An object whose methods return these values, whatever they are asked; a function answers by itself."""
    return SimpleNamespace(**{name: one if callable(one) else lambda *_, one=one, **__: one for name, one in answers.items()})


def realsense(made: Exposures, domain: str = "global_time", metadata: bool = True, serials: tuple[str, ...] = ("A1", "B2")):
    """A module like pyrealsense2 with cameras of those serial numbers."""
    asked: dict = {"stopped": 0}

    def color_frame() -> SimpleNamespace:
        middle_ns, image = made.next()
        read_ns = middle_ns + EXPOSED_NS
        device_us = {"frame": read_ns // 1000 - 10**9, "sensor": middle_ns // 1000 - 10**9}
        stamp_ms = (read_ns if domain != "hardware_clock" else read_ns - 10**15) / 1e6
        about = {"get_timestamp": stamp_ms, "get_frame_timestamp_domain": domain, "get_frame_number": int(image[0, 0, 0])}
        return gives(**about, supports_frame_metadata=metadata, get_frame_metadata=device_us.__getitem__, get_data=image)

    def raw_depth(value: int, shape: tuple[int, int] = (20, 30)) -> SimpleNamespace:
        return gives(get_data=np.full(shape, value, np.uint16))

    def aligned(together: SimpleNamespace) -> SimpleNamespace:
        return gives(get_color_frame=together.get_color_frame(), get_depth_frame=raw_depth(4000, SHAPE[:2]))

    def enabled(stream: str, *rest: int) -> None:
        asked[stream] = rest
        if stream == "color":
            asked["size"] = (*rest[:2], rest[3])

    def started(config: SimpleNamespace) -> SimpleNamespace:
        if asked["size"][0] > 1920:
            raise RuntimeError("Couldn't resolve requests")
        sensor = gives(get_depth_scale=0.0005, supports="baseline".__eq__, get_option=95.0)
        lens = gives(get_intrinsics=SimpleNamespace(fx=500.0))
        return gives(get_device=gives(first_depth_sensor=sensor), get_stream=gives(as_video_stream_profile=lens))

    def waited(timeout_ms: int) -> SimpleNamespace:
        assert timeout_ms == 5000
        # not aligned yet: the depth of another lens, of its own size
        return gives(get_color_frame=color_frame(), get_depth_frame=raw_depth(1))

    def stop() -> None:
        asked["stopped"] += 1

    return SimpleNamespace(
        context=lambda: gives(query_devices=[gives(get_info=serial) for serial in serials]),
        config=lambda: SimpleNamespace(enable_device=lambda serial: asked.update(serial=serial), enable_stream=enabled),
        align=lambda stream: SimpleNamespace(process=aligned) if stream == "color" else None,
        option=SimpleNamespace(stereo_baseline="baseline"),
        pipeline=lambda: SimpleNamespace(start=started, wait_for_frames=waited, stop=stop),
        camera_info=SimpleNamespace(serial_number="serial"),
        stream=SimpleNamespace(color="color", depth="depth"),
        format=SimpleNamespace(rgb8="rgb8", z16="z16"),
        timestamp_domain=SimpleNamespace(hardware_clock="hardware_clock", global_time="global_time", system_time="system_time"),
        frame_metadata_value=SimpleNamespace(frame_timestamp="frame", sensor_timestamp="sensor"),
        asked=asked,
    )


def test_the_camera_asked_for_is_opened_read_to_its_end_and_closed_once(monkeypatch) -> None:
    library = realsense(Exposures())
    monkeypatch.setitem(sys.modules, "pyrealsense2", library)
    source = RealSenseConfig("cam", "B2", "64x48@30").build()
    assert source.size_wh == (64, 48)
    refusal(SourceError, "camera cam: no image any more", lambda: list(source.frames()))
    source.close()
    source.close()
    assert (library.asked["serial"], library.asked["size"], library.asked["stopped"]) == ("B2", (64, 48, 30), 1)


def test_stamps_images_and_numbers_are_right(monkeypatch) -> None:
    made = Exposures()
    monkeypatch.setitem(sys.modules, "pyrealsense2", realsense(made))
    stream = RealSenseConfig("cam", "any", "64x48").build().frames()
    frames = [next(stream) for _ in range(5)]
    assert [frame.seq for frame in frames] == [int(frame.image[0, 0, 0]) for frame in frames] == list(range(5))
    assert {frame.image.shape for frame in frames} == {SHAPE}
    late_ns = np.array([frame.t_ns for frame in frames]) - made.middles_ns
    # a stamp in ms as a float, and the fake's own reading of two clocks
    assert np.abs(late_ns).max() < 1_000_000
    assert all(frame.received_ns - frame.t_ns > EXPOSED_NS for frame in frames)


def test_depth_comes_aligned_with_the_camera_s_own_unit_and_noise(monkeypatch) -> None:
    library = realsense(Exposures())
    monkeypatch.setitem(sys.modules, "pyrealsense2", library)
    frame = next(RealSenseConfig("cam", "any", "64x48@30", depth=True).build().frames())
    assert frame.depth is not None and (frame.depth.values == 4000).all()
    assert (frame.depth.unit_m, frame.depth.noise.focal_px, frame.depth.noise.baseline_m) == (0.0005, 500.0, 0.095)
    assert library.asked["depth"] == ("z16", 30)
    assert next(RealSenseConfig("cam", "any", "64x48").build().frames()).depth is None


# how long reading and transport took at best cannot be seen; without metadata the stamp is taken as it is
@pytest.mark.parametrize(
    ("lacks", "late_ns"),
    [({"domain": "hardware_clock"}, READ_NS), ({"metadata": False}, EXPOSED_NS)],
    ids=["a common clock", "metadata"],
)
def test_a_camera_that_lacks_something_is_late_by_that_and_no_more(monkeypatch, lacks: dict, late_ns: int) -> None:
    made = Exposures()
    monkeypatch.setitem(sys.modules, "pyrealsense2", realsense(made, **lacks))
    stream = RealSenseConfig("cam").build().frames()
    found_ns = [next(stream).t_ns for _ in range(5)]
    np.testing.assert_allclose(np.subtract(found_ns, made.middles_ns), late_ns, rtol=0, atol=1e6 if "metadata" in lacks else 2e6)


def test_what_is_missing_is_one_line(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    refusal(DependencyError, r"pyrealsense2: not usable .* pip install 'posefuse\[", lambda: RealSenseConfig("cam").build())
    monkeypatch.setitem(sys.modules, "pyrealsense2", realsense(Exposures(), serials=()))
    refusal(SourceError, "camera cam: no such camera is connected", lambda: RealSenseConfig("cam").build())
    monkeypatch.setitem(sys.modules, "pyrealsense2", realsense(Exposures()))
    refusal(SourceError, "C3: camera cam: not connected; there are: A1, B2", lambda: RealSenseConfig("cam", "C3").build())
    refusal(SourceError, r"size: expected WIDTHxHEIGHT", lambda: RealSenseConfig("cam", size="large").build())


def test_a_size_the_camera_does_not_have_is_one_line(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", realsense(Exposures()))
    refusal(SourceError, "cannot deliver 4000x3000", lambda: RealSenseConfig("cam", size="4000x3000").build())
