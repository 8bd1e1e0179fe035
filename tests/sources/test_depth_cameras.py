"""RealSense and OAK cameras, with modules like the makers' (names and units of pyrealsense2 2.59, depthai 3.12)."""

import sys
import time
from collections.abc import Callable
from datetime import timedelta
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from checks import refusal

from posefuse.core import DependencyError, SourceError
from posefuse.sources.live import OakConfig, RealSenseConfig

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


def oak(made: Exposures, serials: tuple[str, ...] = ("A1", "B2"), chip: str = "RVC2"):
    """A module like depthai."""
    asked: dict = {"stopped": 0}
    links: set[tuple[str, str]] = set()

    def output(name: str, get: Callable | None = None) -> SimpleNamespace:
        return gives(link=lambda to: links.add((name, to)), createOutputQueue=SimpleNamespace(get=get))

    def taken(timeout: timedelta) -> SimpleNamespace:
        middle_ns, image = made.next()
        steady_ns = middle_ns - (time.time_ns() - time.monotonic_ns())
        ends = {"middle": timedelta(microseconds=steady_ns / 1000)}
        return gives(getTimestamp=ends.__getitem__, getSequenceNum=int(image[0, 0, 0]), getFrame=image)

    def color_output(size: tuple[int, int], form: str, fps: float) -> SimpleNamespace:
        asked.update(size=(*size, fps), form=form)
        return output("color", taken)

    def lens_of(socket: str) -> SimpleNamespace:
        return SimpleNamespace(requestOutput=color_output if socket == "a" else lambda size, fps: output(socket))

    def taken_together(timeout: timedelta) -> dict[str, SimpleNamespace]:
        assert {("color", "sync color"), ("b", "left"), ("c", "right")} <= links
        # by either chip's way, what reaches the host was aligned with color
        assert links >= ({("color", "align to"), ("depth", "sync depth")} if chip == "RVC2" else {("aligned", "sync depth")})
        return {"color": taken(timeout), "depth": gives(getFrame=np.full(SHAPE[:2], 2000, np.uint16))}

    nodes = {
        "camera": SimpleNamespace(build=lens_of),
        "stereo": SimpleNamespace(left="left", right="right", inputAlignTo="align to", depth=output("depth")),
        "sync": SimpleNamespace(inputs={"color": "sync color", "depth": "sync depth"}, out=output("both", taken_together)),
        "align": SimpleNamespace(input="unaligned", inputAlignTo="align to", outputAligned=output("aligned")),
    }

    def pipeline(device: str) -> SimpleNamespace:
        asked["serial"] = device
        stop = lambda: asked.update(stopped=asked["stopped"] + 1)  # noqa: E731
        return gives(create=nodes.__getitem__, getDefaultDevice=gives(getPlatform=chip), start=None, stop=stop)

    class Device:
        getAllAvailableDevices = staticmethod(lambda: [gives(getDeviceId=serial) for serial in serials])

        def __new__(cls, info: SimpleNamespace) -> str:
            return info.getDeviceId()

    return SimpleNamespace(
        Device=Device,
        Pipeline=pipeline,
        node=SimpleNamespace(Camera="camera", StereoDepth="stereo", Sync="sync", ImageAlign="align"),
        CameraBoardSocket=SimpleNamespace(CAM_A="a", CAM_B="b", CAM_C="c"),
        Platform=SimpleNamespace(RVC2="RVC2", RVC4="RVC4"),
        CameraExposureOffset=SimpleNamespace(MIDDLE="middle"),
        ImgFrame=SimpleNamespace(Type=SimpleNamespace(RGB888i="rgb")),
        asked=asked,
    )


CASES = pytest.mark.parametrize(
    ("module", "fake", "config"),
    [("pyrealsense2", realsense, RealSenseConfig), ("depthai", oak, OakConfig)],
    ids=["RealSense", "OAK"],
)


@CASES
def test_the_camera_asked_for_is_opened_read_to_its_end_and_closed_once(monkeypatch, module, fake, config) -> None:
    library = fake(Exposures())
    monkeypatch.setitem(sys.modules, module, library)
    source = config("cam", "B2", "64x48@30").build()
    assert source.size_wh == (64, 48)
    refusal(SourceError, "camera cam: no image any more", lambda: list(source.frames()))
    source.close()
    source.close()
    assert (library.asked["serial"], library.asked["size"], library.asked["stopped"]) == ("B2", (64, 48, 30), 1)


@CASES
def test_stamps_images_and_numbers_are_right(monkeypatch, module: str, fake: Callable, config: type) -> None:
    made = Exposures()
    monkeypatch.setitem(sys.modules, module, fake(made))
    stream = config("cam", "any", "64x48").build().frames()
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


@pytest.mark.parametrize("chip", ["RVC2", "RVC4"])
def test_an_oak_gives_color_and_depth_of_one_moment(monkeypatch, chip: str) -> None:
    library = oak(Exposures(), chip=chip)
    monkeypatch.setitem(sys.modules, "depthai", library)
    frame = next(OakConfig("cam", "any", "64x48", depth=True).build().frames())
    assert frame.depth is not None and (frame.depth.values == 2000).all()
    assert (frame.depth.unit_m, frame.image.shape) == (0.001, SHAPE)


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


@CASES
def test_what_is_missing_is_one_line(monkeypatch, module: str, fake: Callable, config: type) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    refusal(DependencyError, rf"{module}: not usable .* pip install 'posefuse\[", lambda: config("cam").build())
    monkeypatch.setitem(sys.modules, module, fake(Exposures(), serials=()))
    refusal(SourceError, "camera cam: no such camera is connected", lambda: config("cam").build())
    monkeypatch.setitem(sys.modules, module, fake(Exposures()))
    refusal(SourceError, "C3: camera cam: not connected; there are: A1, B2", lambda: config("cam", "C3").build())
    refusal(SourceError, r"size: expected WIDTHxHEIGHT", lambda: config("cam", size="large").build())


def test_a_size_the_camera_does_not_have_is_one_line(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", realsense(Exposures()))
    refusal(SourceError, "cannot deliver 4000x3000", lambda: RealSenseConfig("cam", size="4000x3000").build())
