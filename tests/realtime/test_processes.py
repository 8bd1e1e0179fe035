"""Camera processes that die at the wrong moment."""

import os
import signal
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from posefuse.core import JointCentres
from posefuse.core.skeleton import COCO17
from posefuse.foundation.channel import Channel
from posefuse.realtime import processes
from posefuse.realtime.messages import KeepVideos, Ready, SessionClock, Status, Stop


def ready_at_once(channel: Channel, plan: object) -> None:
    """A group without cameras: ready, then waiting for its end."""
    channel.send(Ready(COCO17, None))
    channel.wait(30.0)


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_a_process_that_dies_between_ready_and_begin_is_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "run_group", ready_at_once)
    groups = processes.Groups([SimpleNamespace(inputs=(), videos=None)])
    try:
        member = groups._members[0]
        while member.marks is None:
            groups._hear_ready(member)
        os.kill(member.worker.pid, signal.SIGKILL)
        member.worker._process.wait(10.0)
        groups.begin(time.monotonic_ns())
        assert "SIGKILL" in member.worker.trouble
        while groups.restarts == 0:
            assert not list(groups.messages())
    finally:
        groups.stop()


def test_one_message_has_the_joint_centres_of_all_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "run_group", ready_with_joint_centres)
    inputs = [(SimpleNamespace(camera="a"), SimpleNamespace(camera="b")), (SimpleNamespace(camera="c"),)]
    plans = [SimpleNamespace(inputs=some, videos=None, clock=SessionClock(0)) for some in inputs]
    with processes.Groups(plans) as groups:
        groups.wait_ready()
        # a topic that keeps its last message would lose those of the other groups
        (centres,) = groups.centres()
    assert centres.cameras == ("a", "b", "c") and centres.table == TABLE


TABLE = JointCentres(made_by="a test", offsets={"hip": {"up": 0.01}})


def ready_with_joint_centres(channel: Channel, plan: object) -> None:
    """A group without cameras whose detector has a table."""
    channel.send(Ready(COCO17, TABLE))
    channel.wait(30.0)


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
    groups = processes.Groups([SimpleNamespace(inputs=(), videos=None, folder=tmp_path)])
    try:
        while groups._members[0].marks is None:
            groups._hear_ready(groups._members[0])
        groups.control(KeepVideos(tmp_path))
        if stopped_before:
            groups.control(KeepVideos(None))
    finally:
        groups.stop()
    assert (tmp_path / "finished").exists()
