"""A machine that is too slow is reported as that: once, with what helps; no camera is called dead or silent for it."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest
from built import camera_state
from live_session import until
from no_outputs import NoOutputs

from posefuse.cli.live import exit_code
from posefuse.core import CameraHealth, Detections2D, JointCentres
from posefuse.core.skeleton import COCO17
from posefuse.foundation.channel import Channel
from posefuse.foundation.worker import Worker
from posefuse.health.camera_monitor import Monitor
from posefuse.realtime import notices, processes
from posefuse.realtime.messages import KeepVideos, Ready, SessionClock, Status, Stop
from posefuse.realtime.notices import News, never_waiting
from posefuse.realtime.session import closing_lines

S = 1_000_000_000


@pytest.mark.parametrize(("share", "watches", "lines"), [(0.09, True, 1), (0.7, True, 0), (0.09, False, 0)])
def test_a_slow_machine_is_reported_once_with_what_helps(share: float, watches: bool, lines: int) -> None:
    monitor, found = Monitor(("a", "b", "c")), []
    fusion = SimpleNamespace(
        rig=SimpleNamespace(names=("a", "b", "c")), monitor=monitor, watch=None, noise_scale=None, outlets=NoOutputs()
    )
    news = News(fusion, 0, found.append, watches_pace=watches)
    for t in range(60):
        for camera in "abc":
            # the process of one is started again
            since = t if camera == "a" or t < 25 else t - 25
            monitor.take_state(camera_state(camera, 30 * since, round(share * 30 * since)), t * S)
        news.report(t * S)
    advice = "use fewer cameras, cameras at a lower frame rate, or a smaller network"
    assert [line[10:] for line in found] == [f"this computer processes 9% of the images: {advice}"] * lines


def of_cameras(*names: str) -> Monitor:
    """Of cameras that each had a view at zero."""
    monitor = Monitor(names)
    for name in names:
        monitor.admit(Detections2D.empty(name, 0, COCO17), 0, received_ns=0, still=0)
    return monitor


def test_a_camera_whose_frames_wait_is_not_silent() -> None:
    monitor = of_cameras("slow", "gone")
    for t in range(5):
        monitor.take_state(camera_state("slow", 30 * t, 1), t * S)
        monitor.take_state(camera_state("gone", 1, 1), t * S)
    verdicts = monitor.judge(4 * S, {})
    assert (verdicts["slow"].state, verdicts["gone"].state) == ("overload", "silent")


def test_a_camera_is_not_silent_while_its_process_owes_a_report() -> None:
    """A process at work on one image reports when that is done; it is judged itself meanwhile."""
    for regular, state_at in ((True, "ok"), (False, "silent")):
        monitor = of_cameras("a")
        monitor.take_state(camera_state("a", 1, 1), 0, regular=regular)
        assert monitor.judge(S * 3 // 2, {})["a"].state == state_at
        assert monitor.judge(S * 5 // 2, {})["a"].state == "silent"


OK, DEAD = CameraHealth("ok"), CameraHealth("dead", "process 1 ended")


def reported(verdicts: Iterable[CameraHealth], every_ns: int) -> tuple[Monitor, list[str]]:
    """What is printed of a camera that is judged so, one time after the other."""
    monitor, lines = Monitor(("a",)), []
    fusion = SimpleNamespace(monitor=monitor, watch=None, noise_scale=None, outlets=NoOutputs())
    news = News(fusion, 0, lines.append, watches_pace=False)
    for i, verdict in enumerate(verdicts):
        monitor.judge(i * every_ns, {"a": verdict})
        news.report(i * every_ns)
    return monitor, lines


def test_changes_of_a_camera_are_printed_ten_seconds_apart() -> None:
    monitor, lines = reported([OK, DEAD] * 120, S // 4)
    times = [float(line.split()[0]) for line in lines]
    assert monitor.event_count > 200 and 4 <= len(lines) <= 7
    assert all(later - sooner >= 9.7 for sooner, later in pairwise(times[1:]))


def test_the_first_trouble_of_a_camera_is_printed_at_once() -> None:
    _, lines = reported([OK, DEAD, *[OK] * 20], S)
    assert [line.split("camera a: ")[1] for line in lines] == ["ok", "dead: process 1 ended", "ok"]


def test_all_that_changes_is_reported_however_long_a_session_runs() -> None:
    monitor, lines = reported([OK, DEAD] * 600, 11 * S)
    assert len(lines) == monitor.event_count > len(monitor.events)
    assert lines[-1] == "13189.00 s  camera a: dead: process 1 ended"


def spin(channel: Channel) -> None:
    while True:
        pass


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux reports the processor time of another process here")
def test_a_process_that_works_is_slow_and_one_that_does_nothing_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    worker = Worker(spin)
    worker.start()
    monkeypatch.setattr(processes, "SILENT_S", 0.2)
    monkeypatch.setattr(processes, "_HUNG_S", 0.5)
    try:
        member = processes._Member(plan=None, worker=worker, ready=True)
        for wait_s in (0.3, *[0.2] * 7):
            time.sleep(wait_s)
            assert processes._silence(member).state == "overload"
        assert not processes._hangs(member)
        monkeypatch.setattr(processes, "_HUNG_BUSY_S", 0.01)
        assert processes._hangs(member), "nothing came of much work"
        monkeypatch.undo()
        os.kill(worker.pid, signal.SIGSTOP)
        time.sleep(0.2)
        monkeypatch.setattr(worker, "silent_s", lambda: 60.0)
        member.used_s = None
        assert processes._silence(member).state == "dead" and processes._hangs(member)
    finally:
        worker.end(0.0)


def test_a_process_that_has_just_begun_has_its_trouble_until_its_cameras_are_open() -> None:
    groups = object.__new__(processes.Groups)
    member = processes._Member(plan=SimpleNamespace(inputs=()), worker=Worker(spin), ready=True)
    member.worker.trouble = "ended"
    groups._took(member, Status(0, (replace(camera_state("a", 1, 1), state="opening"),)))
    assert member.worker.trouble == "ended"
    groups._took(member, Status(0, (camera_state("a", 1, 1),)))
    assert not member.worker.trouble


@pytest.mark.parametrize(
    ("came", "used", "seen", "why"),
    [
        (0, 0, (0, 0, 0), "no image of any camera was processed"),
        (1000, 30, (5, 5, 0), "this computer is too slow"),
        (1000, 300, (0, 0, 0), "in none of 3 cameras; 2 at once"),
        (1000, 300, (9, 0, 0), "in one camera only (a) of 3"),
        (1000, 300, (9, 9, 0), "seen by a, b, but not at one place"),
    ],
)
def test_a_session_without_a_person_names_the_reason(came: int, used: int, seen: tuple[int, ...], why: str) -> None:
    names = ("a", "b", "c")
    monitor = Monitor(names)
    for name in names:
        monitor.take_state(camera_state(name, came // 3, used), 0)
    fusion = SimpleNamespace(
        rig=SimpleNamespace(names=names), monitor=monitor, used=dict.fromkeys(names, used),
        seen=dict(zip(names, seen, strict=True)), poses_with_people=0,
    )  # fmt: skip
    lines = list(closing_lines(fusion))
    assert len(lines) == 1 + (0 < used < 100) and lines[-1].startswith("no person was tracked: ")
    assert why in lines[-1]
    fusion.poses_with_people = 1
    assert not any("no person" in line for line in closing_lines(fusion))


@pytest.mark.parametrize(
    ("people", "stopped_by", "failed", "code"),
    [(False, "", False, 3), (True, "", False, 0), (False, "", True, 1), (False, "SIGTERM", False, 143)],
)
def test_a_session_without_a_person_has_an_exit_code_of_its_own(people: bool, stopped_by: str, failed: bool, code: int) -> None:
    run = SimpleNamespace(stopped_by=stopped_by, failed=failed, people=people)
    assert exit_code(run, 10.0, SimpleNamespace(note=print)) == code


# --- camera processes that die at the wrong moment


TABLE = JointCentres(made_by="a test", offsets={"hip": {"up": 0.01}})


def ready_at_once(channel: Channel, plan: object) -> None:
    """A group without cameras whose detector has a table: ready, then waiting for its end."""
    channel.send(Ready(COCO17, TABLE))
    channel.wait(30.0)


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_a_process_that_dies_between_ready_and_begin_is_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "run_group", ready_at_once)
    with processes.Groups([SimpleNamespace(inputs=(), videos=None)]) as groups:
        groups.wait_ready()
        member = groups._members[0]
        os.kill(member.worker.pid, signal.SIGKILL)
        member.worker._process.wait(10.0)
        groups.begin(time.monotonic_ns())
        assert "SIGKILL" in member.worker.trouble
        while groups.restarts == 0:
            assert not list(groups.messages())


def test_one_message_has_the_joint_centres_of_all_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "run_group", ready_at_once)
    inputs = [(SimpleNamespace(camera="a"), SimpleNamespace(camera="b")), (SimpleNamespace(camera="c"),)]
    plans = [SimpleNamespace(inputs=some, videos=None, clock=SessionClock(0)) for some in inputs]
    with processes.Groups(plans) as groups:
        groups.wait_ready()
        # a topic that keeps its last message would lose those of the other groups
        (centres,) = groups.centres()
    assert centres.cameras == ("a", "b", "c") and centres.table == TABLE


def slow_to_finish(channel: Channel, plan: SimpleNamespace) -> None:
    """A group that was asked to keep videos, and needs longer for their end than one without progress is waited for."""
    channel.send(Ready(COCO17, None))
    while not isinstance(channel.receive(), Stop):
        channel.wait(30.0)
    for _ in range(30):
        time.sleep(0.1)
        channel.send(Status(0, ()))
    (plan.folder / "finished").touch()


@pytest.mark.parametrize("stopped_before", [False, True])
def test_videos_switched_on_during_a_session_are_finished_at_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stopped_before: bool
) -> None:
    monkeypatch.setattr(processes, "run_group", slow_to_finish)
    monkeypatch.setattr(processes, "FINISH_S", 1.0)
    with processes.Groups([SimpleNamespace(inputs=(), videos=None, folder=tmp_path)]) as groups:
        groups.wait_ready()
        for folder in (tmp_path, None) if stopped_before else (tmp_path,):
            groups.control(KeepVideos(folder))
    assert (tmp_path / "finished").exists()


# --- news of a session whose reader has stopped, or has gone


def test_a_reader_that_has_stopped_keeps_no_one_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(notices, "_END_S", 0.1)
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
