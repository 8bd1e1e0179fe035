"""The whole way from Python, on the bundled clip."""

import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from checks import refusal

import posefuse as pf
from posefuse.core import ConfigError, InputError, LivePreview, SourceError


@pytest.fixture(scope="module")
def tracked(demo_session: Path, models: None) -> pf.Recording:
    return pf.track(demo_session, end_s=1.0)


def test_arguments_about_the_folder_need_the_folder(demo_session: Path) -> None:
    refusal(InputError, "out", pf.track, demo_session, resume=True)


def test_other_settings_are_used_and_remembered(tracked: pf.Recording) -> None:
    raw = tracked.solve(smooth=False, settings={"fuse.weights": "score"})
    assert raw.provenance["config"]["fuse"]["weights"] == "score"
    assert not np.array_equal(raw.poses.xyz_world, tracked.poses.xyz_world)
    refusal(ConfigError, "wieghts", tracked.solve, settings={"fuse.wieghts": "score"})


def test_a_study_takes_a_network_and_a_processor_as_a_session_does(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    monkeypatch.setattr("posefuse.pipeline.batch.run_study", lambda *_, settings, **__: asked.append(settings))
    pf.batch("study", "out", networks="rtmpose_m", device="cpu", settings={"rate_hz": 30})
    pf.batch("study", "out", networks=Path("blazepose_lite"))
    chosen = {"detector.name": "onnx", "detector.options.card": "rtmpose_m", "detector.options.device": "cpu"}
    # a card of one's own is a file, and may be given as one
    assert asked == [{**chosen, "rate_hz": 30}, {"detector.options.landmarks": "blazepose_lite"}]


def test_progress_is_reported_in_order(demo_session: Path, models: None) -> None:
    reports: list[tuple[str, int, int | None]] = []
    pf.track(demo_session, end_s=0.3, progress=lambda stage, done, total, message="": reports.append((stage, done, total)))
    steps = [done for stage, done, total in reports if stage == "detect" and total is not None]
    assert steps == sorted(steps)
    assert steps[-1] == 10


def test_a_detector_takes_plain_images(demo_session: Path, models: None) -> None:
    from posefuse.sources import VideoConfig

    image = next(VideoConfig(demo_session / "videos" / "cam00.mp4", "cam00").build().frames()).image
    detect = pf.detector("blazepose_lite")
    found, no_person = detect([image, np.zeros_like(image)])
    assert (len(found), len(no_person)) == (1, 0)
    assert found.xy_img.shape == (1, len(detect.skeleton), 2)


def test_an_output_that_is_switched_on_later_is_where_ros_is(demo_session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cyclonedds", reason="the extra `ros` is not installed")
    session = pf.live(demo_session / "rig.toml", [f"sim:{demo_session}"], ros={"domain_id": 5, "peers": ["10.0.0.7"]})
    asked: list[Any] = []
    monkeypatch.setattr(session, "_ask", asked.append)
    session.switch_on("ros2")
    session.switch_on("ros2", {"domain_id": 6})
    assert [(one.config.domain_id, one.config.peers) for one in asked] == [(5, ("10.0.0.7",)), (6, ("10.0.0.7",))]


def test_where_ros_2_is_has_no_effect_on_a_session_without_it_which_is_refused(demo_session: Path, monkeypatch) -> None:
    monkeypatch.setattr("posefuse.realtime.networks.fetch_networks", lambda *_: pytest.fail("networks were fetched"))
    session = pf.live(demo_session / "rig.toml", [f"sim:{demo_session}"], ros={"domain_id": 5})
    refusal(ConfigError, "`domain_id=5`: no source and no output is in ROS 2; leave it out, or add one", session.__enter__)


class _Session:
    """In place of the session's process: it sends one message, and runs until it is ended."""

    running, trouble = False, ""

    def __init__(self, message: Any) -> None:
        self._messages = deque([message])

    def start(self, *_: Any) -> None:
        self.running = True

    def send(self, *_: Any) -> bool:
        return self.running

    def receive(self) -> Any:
        return self._messages.popleft() if self._messages else None

    def wait(self, timeout_s: float) -> bool:
        time.sleep(0.01)
        return bool(self._messages)

    def end(self, wait_s: float) -> None:
        self.running = False


@pytest.fixture
def session_that_sends(demo_session: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    def make(message: Any, **options: Any) -> Any:
        monkeypatch.setattr("posefuse.realtime.networks.fetch_networks", lambda *_: None)
        monkeypatch.setattr("posefuse.api.live.Worker", lambda _: _Session(message))
        return pf.live(demo_session / "rig.toml", [f"sim:{demo_session}"], **options)

    return make


@pytest.mark.parametrize("message", ["a line of news", LivePreview(camera="cam00", t_ns=0, jpeg=b"", size_wh=(64, 48))])
def test_what_a_function_of_the_program_raises_ends_the_session_and_is_raised(session_that_sends, message: Any) -> None:
    """The session continued, and the program waited for poses without end."""

    def fail(*_: Any) -> None:
        raise KeyError("of the program")

    session = session_that_sends(message, progress=fail)
    session.on_image = fail
    with pytest.raises(KeyError, match="of the program"), session:
        pass
    assert session.ended


def test_poses_of_a_session_that_has_not_begun_are_refused(session_that_sends) -> None:
    """A program without ``with`` had waited without end."""
    refusal(SourceError, r"has not begun; use it as `with posefuse\.live", next, iter(session_that_sends("news")))


def test_a_session_that_is_over_does_not_begin_again(session_that_sends) -> None:
    """The second time there were no poses, and no word of it."""
    session = session_that_sends("news")
    session.close()
    refusal(SourceError, "a session runs once", session.__enter__)


@pytest.mark.realtime
def test_poses_come_while_the_session_runs(demo_session: Path, models: None) -> None:
    rig = pf.read_rig(demo_session / "rig.toml")
    sources = {name: f"video:{demo_session / 'videos' / name}.mp4" for name in rig.names}
    times, people = [], 0
    with pf.live(rig, sources, duration_s=4.0) as session:
        for pose in session:
            times.append(pose.t_ns)
            people = max(people, len(pose.person_id))
    assert people == 1
    assert len(times) > 20
    assert (np.diff(times) > 0).all()
    assert set(session.cameras) == set(rig.names)


@pytest.mark.realtime
def test_a_camera_that_cannot_be_opened_is_reported_at_the_start_and_nothing_is_left_behind(demo_session, models) -> None:
    rig = pf.read_rig(demo_session / "rig.toml")
    before = set(threading.enumerate())
    nowhere = {name: f"video:{name}.mp4" for name in rig.names}
    with pytest.raises(SourceError, match=r"cam00\.mp4"), pf.live(rig, nowhere):
        pass
    end_s = time.monotonic() + 10
    while set(threading.enumerate()) - before and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not set(threading.enumerate()) - before
    session = pf.live(rig, nowhere)
    session.close()
    session.close()
