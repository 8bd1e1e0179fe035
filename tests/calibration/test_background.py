"""A camera that is turned while it records is named from its background, and nothing else is."""

import dataclasses
import itertools
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import built
import cv2
import numpy as np
import pytest
from commands import oracle

import posefuse as pf
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.extrinsics import target as moving_target
from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration, after
from posefuse.calibration.targets.coverage import coverage
from posefuse.core import SE3, Array, Camera, Frame
from posefuse.formats.video import VideoWriter
from posefuse.health.background import background_of
from posefuse.pipeline.calibration import background_of_person
from posefuse.sources import VideoConfig, VideoSource

SIZE_WH, FRAMES, PERIOD_NS = (640, 480), 90, 100_000_000
K = np.array([[560.0, 0, 319.5], [0, 560, 239.5], [0, 0, 1]])
CAMERA = Camera(name="cam00", size_wh=SIZE_WH, K=K, cam_from_world=SE3.identity())
Turn = Callable[[float], Array]


class Drawn:
    """A recording that is drawn: a background that the camera turns away from, and a textured thing that crosses it."""

    camera, size_wh, stated_frames = "cam00", SIZE_WH, FRAMES

    def __init__(self, turn_deg: Turn, *, plain: bool = False, thing: int = 180, jumps: bool = False, light: float = 1.0) -> None:
        random = np.random.default_rng(0)
        self.turn_deg, self.light, self.jumps, self.looks = turn_deg, light, jumps, 0
        self.wall = _texture(random, (720, 960)) if not plain else np.full((720, 960), 120, np.uint8)
        self.thing = _texture(random, (thing, thing)) if thing else np.zeros((0, 0), np.uint8)

    def times_ns(self) -> Array:
        return np.arange(FRAMES) * PERIOD_NS

    def frames_from(self, begin_ns: int) -> Iterator[Frame]:
        for i in range(-(-begin_ns // PERIOD_NS), FRAMES):
            self.looks += 1
            yield self._frame(i)

    def _frame(self, i: int) -> Frame:
        rotation = cv2.Rodrigues(np.deg2rad(self.turn_deg(i / FRAMES)))[0]
        place = np.array([[1, 0, -160], [0, 1, -120], [0, 0, 1.0]])
        image = cv2.warpPerspective(self.wall, K @ rotation @ np.linalg.inv(K) @ place, SIZE_WH)
        size = len(self.thing)
        left = (74 * i if self.jumps else 6 * i) % (SIZE_WH[0] - size)
        top = (SIZE_WH[1] - size) // 2
        image[top : top + size, left : left + size] = self.thing
        noise = np.random.default_rng(i).normal(0, 2, image.shape)
        image = np.clip(image * (self.light if i > 40 else 1.0) + noise, 0, 255).astype(np.uint8)
        return built.frame("cam00", i * PERIOD_NS, np.repeat(image[..., None], 3, axis=2), seq=i)


def _texture(random: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Blocks of 12 px, slightly blurred."""
    blocks = random.integers(30, 200, (-(-shape[0] // 12), -(-shape[1] // 12))).astype(np.uint8)
    return np.asarray(cv2.GaussianBlur(np.kron(blocks, np.ones((12, 12), np.uint8)), (3, 3), 0)[: shape[0], : shape[1]])


def step(degrees: float, axis: tuple[float, float, float], at: float = 0.6) -> Turn:
    return lambda share: degrees * np.array(axis) * (share > at)


STILL = step(0, (0, 0, 0))


@pytest.mark.parametrize("degrees", [0.5, 0.7, 3.0])
@pytest.mark.parametrize("axis", [(0.0, 1.0, 0.0), (0.6, 0.8, 0.0), (0.0, 0.0, 1.0)])
def test_a_turned_camera_is_named_with_angle_and_time(degrees: float, axis: tuple[float, float, float]) -> None:
    source = Drawn(step(degrees, axis), jumps=True)
    [found] = background_of([source], [CAMERA]).moved
    assert (found.kind, found.cameras) == ("moved", ("cam00",))
    assert np.rad2deg(found.amount) == pytest.approx(degrees, abs=0.12)
    assert found.t_ns / 1e9 == pytest.approx(5.4, abs=0.3)
    assert source.looks <= 10, "so few frames are decoded"


@pytest.mark.parametrize(
    "source", [Drawn(STILL), Drawn(STILL, thing=400, jumps=True), Drawn(STILL, light=0.7), Drawn(step(0.2, (1, 0, 0)))]
)
def test_a_camera_that_stands_still_is_not(source: Drawn) -> None:
    source.looks = 0
    found = background_of([source], [CAMERA])
    assert (found.moved, found.still, found.unknown) == ((), ("cam00",), ())
    assert source.looks == 2, "a good session costs two frames"
    assert [check.passed for check in found.report.checks] == [True]


@pytest.mark.parametrize("source", [Drawn(STILL, plain=True), Drawn(STILL, plain=True, thing=440)])
def test_a_wall_without_features_is_not_checked_and_does_not_pass(source: Drawn) -> None:
    found = background_of([source], [CAMERA])
    assert (found.moved, found.still, found.unknown) == ((), (), ("cam00",))
    assert not found.report.checks
    assert "not checked in cam00" in found.report.notes[0]


def test_a_camera_that_sinks_is_named_and_one_that_sways_is_not_checked() -> None:
    sinks = background_of([Drawn(lambda share: np.array([0.9 * share, 0, 0]))], [CAMERA])
    assert np.rad2deg(sinks.moved[0].amount) == pytest.approx(0.83, abs=0.1)
    sways = background_of([Drawn(lambda share: np.array([0, np.sin(20 * share), 0]))], [CAMERA])
    assert (sways.moved, sways.unknown) == ((), ("cam00",))


@pytest.mark.parametrize("folder", ["pose2sim_single/videos", "caliscope/post_optimization/calibration/extrinsic"])
def test_real_cameras_stand_still(shared_data: Path, folder: str) -> None:
    sources = [VideoConfig(path, path.stem).build() for path in sorted((shared_data / folder).glob("*.mp4"))]
    cameras = [dataclasses.replace(CAMERA.scaled(source.size_wh), name=source.camera) for source in sources]
    assert background_of(sources, cameras).still == tuple(camera.name for camera in cameras)


class Turned:
    """A video as a camera shows it that turns by some degrees, 1 s after the beginning."""

    def __init__(self, source: VideoSource, camera: Camera, degrees: tuple[float, float, float]) -> None:
        self.source, self.camera = source, camera.name
        rotation = cv2.Rodrigues(np.deg2rad(degrees))[0]
        self.homography = camera.K @ rotation @ np.linalg.inv(camera.K)

    def times_ns(self) -> Array:
        return self.source.times_ns()

    def frames_from(self, begin_ns: int) -> Iterator[Frame]:
        for frame in self.source.frames_from(begin_ns):
            image = cv2.warpPerspective(frame.image, self.homography, frame.size_wh)
            yield dataclasses.replace(frame, image=image) if frame.t_ns > 1e9 else frame


@pytest.mark.parametrize("degrees", [(0.0, 0.5, 0.0), (0.6, 0.0, 0.0), (0.0, 0.0, 0.7), (1.8, 2.4, 0.0)])
def test_people_before_the_background_do_not_matter(demo_session: Path, degrees: tuple[float, float, float]) -> None:
    rig = pf.read_rig(demo_session / "rig.toml")
    videos = [VideoConfig(demo_session / "videos" / f"{camera.name}.mp4", camera.name).build() for camera in rig]
    turned: list[Any] = [Turned(video, camera, degrees) for video, camera in zip(videos, rig, strict=True)]
    found = background_of(turned, rig.cameras)
    assert [one.cameras for one in found.moved] == [(name,) for name in rig.names]
    angle = np.rad2deg([one.amount for one in found.moved])
    np.testing.assert_allclose(angle, np.linalg.norm(degrees), atol=0.02)


def test_cameras_that_turn_refuse_a_calibration_that_fits(lab: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    turns = {"cam01": step(0.7, (0, 1, 0), 0.4), "cam02": step(0.6, (1, 0, 0), 0.7)}
    videos = {name: tmp_path / f"{name}.mp4" for name in lab.rig.names}
    for name, path in videos.items():
        drawn = Drawn(turns.get(name, STILL))
        with VideoWriter(path, SIZE_WH, 2.5) as video:
            for t_ns in drawn.times_ns()[::4].tolist():
                video.write(next(drawn.frames_from(t_ns)).image, t_ns)
    seen = lab.watch(motion=dataclasses.replace(lab.motion, seconds=2.0))
    known = {"position_cov_m2": np.zeros((4, 3, 3)), "clocks": ClockEstimate.known(np.zeros(4), 0.0)}
    report = CalibrationReport("extrinsics", (Check("corners fit", True, "all"),))
    fits = moving_target.Calibration(rig=lab.rig, report=report, coverage=coverage(seen), **known)
    monkeypatch.setattr(moving_target, "calibrate_extrinsics", lambda *_: fits)
    arguments = {"intrinsics": lab.rig, "target": lab.target}
    assert not pf.calibrate_extrinsics(seen, **arguments).report.failed
    recorded = dataclasses.replace(seen, recordings=tuple(videos.items()))
    with pytest.raises(RefusedCalibration, match=r"cam01 turns by 0\.7\d deg .*cam02 turns by 0\.[56]\d deg") as refused:
        pf.calibrate_extrinsics(recorded, **arguments)
    assert [check.name for check in refused.value.report.failed] == ["background stands still"]
    kept = pf.calibrate_extrinsics(recorded, **arguments, keep_refused=True)
    assert kept.rig.refused == "background stands still"
    assert len(background_of_person(videos, lab.rig.cameras).failed) == 1
    assert not background_of_person({"cam00": tmp_path / "poses.json"}, lab.rig.cameras).checks


def test_what_fails_in_the_input_and_in_the_calibration_is_refused_together() -> None:
    background = CalibrationReport("background", (Check("stands still", False, "turned"),), ("one not checked",))

    def refuse() -> CalibrationReport:
        raise RefusedCalibration(CalibrationReport("extrinsics", (Check("corners fit", False, "none"),), ("a note",)), "kept")

    with pytest.raises(RefusedCalibration, match=r"^extrinsics: stands still: turned \(also failed: corners fit\)$") as refused:
        after(background, refuse)
    assert (refused.value.kept, refused.value.report.notes) == ("kept", ("one not checked", "a note"))


def test_track_warns_as_it_begins_and_the_result_keeps_it(demo_session: Path, tmp_path: Path) -> None:
    session = tmp_path / "demo"
    shutil.copytree(demo_session, session)
    video = VideoConfig(demo_session / "videos" / "cam01.mp4", "cam01").build()
    turned = Turned(video, pf.read_rig(demo_session / "rig.toml")["cam01"], (0.0, 0.7, 0.0))
    with VideoWriter(session / "videos" / "cam01.mp4", video.size_wh, 30.0) as kept:
        for frame in itertools.islice(turned.frames_from(0), 64):
            kept.write(frame.image, frame.t_ns)
    with pytest.warns(UserWarning, match=r"background of cam01 turns by 0\.[67]\d deg .* between (0\.\d|1\.0) and 1\.[01] s"):
        found = pf.track(session, end_s=2.0, settings=oracle(demo_session))
    assert "background of cam01" in found.provenance["rig_warnings"][0]
