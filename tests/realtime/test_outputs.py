"""Outputs of a live session that fail: it is reported, they continue in a new file, and nothing is written over."""

import os
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from checks import refusal
from live_session import until
from made_up_session import made_up_messages, made_up_rig, made_up_start

from posefuse.core import InputError, LiveHealth, LiveJointCentres, LiveMessage, LiveNames, LivePose, LiveStart
from posefuse.core.live_messages import FAILED, OK
from posefuse.realtime import outputs as outputs_module
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.messages import LivePlan, SessionClock
from posefuse.realtime.output_process import HANGS, OutputAdded, OutputThread
from posefuse.realtime.outputs import OutputProcess, notes_of
from posefuse_ros import topics
from posefuse_ros.bags import read_mcap, read_notes, read_poses
from posefuse_ros.live_output import health_lines
from posefuse_ros.mcap_output import RecordConfig
from posefuse_ros.messages import names_from_message

MESSAGES = list(made_up_messages())
POSE = next(message for message in MESSAGES if isinstance(message, LivePose) and len(message.pose.person_id) == 2)
CENTRES = next(message for message in MESSAGES if isinstance(message, LiveJointCentres))
PATIENCE_S = 60.0


@contextmanager
def running(config: "Scripted", kept: Sequence[LiveMessage] = ()) -> Iterator[OutputThread]:
    """The output in its thread, finished at the end; `kept`: what came before it was opened."""
    worker = OutputThread(OutputAdded("scripted", config, made_up_start(1), kept=list(kept)))
    yield worker
    worker.finish()
    worker.join(PATIENCE_S)


@dataclass(frozen=True)
class Scripted:
    """An output that fails where its script says; `log` holds what happened."""

    fails: Callable[[int], Exception | None] = lambda count: None
    close_fails: bool = False
    open_fails: Callable[[int], Exception | None] = lambda part: None
    waits_s: float = 0.0
    log: list = field(default_factory=list)
    takes = (LivePose, LiveJointCentres)
    keeps_all = True

    def build(self):
        return ScriptedOutput(self)


class ScriptedOutput:
    name = "scripted"

    def __init__(self, config: Scripted) -> None:
        self.config, self.where = config, ""

    def take(self, message) -> None:
        if isinstance(message, LiveStart):
            self.where = f"part {message.part}"
            if error := self.config.open_fails(message.part):
                raise error
        elif isinstance(message, LivePose):
            time.sleep(self.config.waits_s)
            if error := self.config.fails(sum(what == "pose" for what, _ in self.config.log)):
                self.config.log.append(("pose", "failed"))
                raise error
        self.config.log.append((type(message).__name__.removeprefix("Live").lower(), self.where))

    def close(self) -> None:
        self.config.log.append(("close", self.where))
        if self.config.close_fails:
            raise OSError(28, "No space left on device")


def test_an_output_that_raises_an_error_is_reported_closed_and_reopened(capfd) -> None:
    config = Scripted(fails=lambda count: ValueError("two\nlines") if count == 2 else None)
    with running(config) as worker:
        worker.put(CENTRES)
        until(lambda: worker.health().failures == 1, lambda: worker.put(POSE))
        failed = worker.health()
        assert (failed.state, failed.text) == (FAILED, "part 1: ValueError: two lines")
        until(lambda: worker.health().state == OK, lambda: worker.put(POSE))
        until(lambda: config.log[-1] == ("pose", "part 2"), lambda: worker.put(POSE))
    health = worker.health()
    assert (health.failures, health.fault, health.text, health.where) == (1, failed.text, "continues in part 2", "part 2")
    first, second = config.log[:6], config.log[6:9]
    assert first == [
        ("start", "part 1"), ("jointcentres", "part 1"), ("pose", "part 1"), ("pose", "part 1"), ("pose", "failed"),
        ("close", "part 1"),
    ]  # fmt: skip
    # what a replay must know stands in the new part, too
    assert second == [("start", "part 2"), ("jointcentres", "part 2"), ("pose", "part 2")]
    assert config.log[-1] == ("close", "part 2")
    assert health.dropped >= 1
    assert capfd.readouterr() == ("", "")


def test_repeated_failures_to_reopen_count_as_one_failure_and_one_part(monkeypatch) -> None:
    monkeypatch.setattr("posefuse.realtime.output_process._FIRST_RETRY_S", 0.001)
    monkeypatch.setattr("posefuse.realtime.output_process._LONGEST_RETRY_S", 0.001)
    tries: list[int] = []

    def busy(part: int) -> Exception | None:
        tries.append(part)
        return InputError("still full") if 1 < len(tries) < 6 else None

    config = Scripted(fails=lambda count: OSError(28, "No space left on device") if count == 0 else None, open_fails=busy)
    with running(config) as worker:
        until(lambda: worker.health().taken > 0, lambda: worker.put(POSE))
        assert tries == [1, 2, 2, 2, 2, 2]
        assert worker.health().failures == 1


def test_an_error_during_closing_counts_as_a_failure_without_a_traceback(capfd) -> None:
    with running(Scripted(close_fails=True)) as worker:
        worker.put(POSE)
    health = worker.health()
    assert (health.state, health.failures, health.taken) == (FAILED, 1, 1)
    assert health.fault == "not finished: part 1: No space left on device"
    assert capfd.readouterr() == ("", "")


def test_an_output_that_hangs_is_reported(monkeypatch) -> None:
    monkeypatch.setattr("posefuse.realtime.output_process._HANGS_S", 0.05)
    with running(Scripted(waits_s=0.5)) as worker:
        worker.put(POSE)
        until(lambda: worker.health().state == HANGS)
        until(lambda: worker.health().state == OK)
        assert worker.health().failures == 0


def test_an_output_that_hangs_while_it_is_opened_again_is_reported(monkeypatch) -> None:
    monkeypatch.setattr("posefuse.realtime.output_process._HANGS_S", 0.05)
    monkeypatch.setattr("posefuse.realtime.output_process._FIRST_RETRY_S", 0.01)
    opened = threading.Event()
    config = Scripted(
        fails=lambda count: OSError(5, "unplugged"),
        open_fails=lambda part: opened.wait(PATIENCE_S) and None if part > 1 else None,
    )
    with running(config) as worker:
        until(lambda: worker.health().state == HANGS, lambda: worker.put(POSE))
        assert worker.health().text == "has been opening for more than 0.05 s"
        opened.set()
        until(lambda: worker.health().state == FAILED)


def test_an_output_receives_only_the_messages_it_accepts() -> None:
    config, later = Scripted(), Scripted()
    with running(config) as worker:
        for message in MESSAGES:
            worker.put(message)
    assert {what for what, _ in config.log} == {"start", "jointcentres", "pose", "close"}
    assert worker.health().dropped == 0
    with running(later, [CENTRES, LiveNames(t_ns=POSE.pose.t_ns, names={7: "Ada"})]):
        pass
    assert [what for what, _ in later.log] == ["start", "jointcentres", "close"]


@dataclass(frozen=True)
class Slow:
    """Takes a pose every 0.1 s, and notes its end in a file."""

    path: Path
    takes: ClassVar[tuple[type, ...]] = (LivePose,)
    keeps_all: ClassVar[bool] = True
    where = ""

    def build(self) -> "Slow":
        return self

    def take(self, message: LiveMessage) -> None:
        time.sleep(0.1)

    def close(self) -> None:
        self.path.write_text("closed")


def outputs_to(path: Path) -> OutputProcess:
    configs = {"record": RecordConfig(path=path)}
    return OutputProcess(LivePlan(rig=made_up_rig(), inputs=(), config=LiveConfig(), outputs=configs), SessionClock.begin())


class Fed:
    """An output process that is offered messages, as a session does."""

    def __init__(self, path: Path) -> None:
        pytest.importorskip("rosbags", reason="the extra ros is not installed")
        self.outputs = outputs_to(path)
        self.outputs.wait_ready()
        self.count = 0
        self.outputs.offer(CENTRES)

    def feed(self) -> None:
        self.count += 1
        # noise: a recording packs anything else to almost nothing
        noise = np.random.default_rng(self.count).normal(size=POSE.pose.cov_world.shape)
        pose = replace(POSE.pose, t_ns=POSE.pose.t_ns + self.count, cov_world=noise)
        self.outputs.offer(replace(POSE, pose=pose))
        self.outputs.poll()

    def kill(self, number: int = signal.SIGKILL) -> int:
        """Its process, by this signal."""
        pid = int(self.outputs.whereabouts().split()[-1])
        os.kill(pid, number)
        return pid

    def state(self, name: str = "record") -> str:
        return self.outputs.health[name].state

    def taken(self, name: str = "record") -> int:
        return self.outputs.health[name].taken

    def take_more(self, count: int, name: str = "record") -> None:
        """Feed until an output has taken more than so many more."""
        before = self.taken(name) if name in self.outputs.health else 0
        until(lambda: self.taken(name) > before + count, self.feed)

    def events(self) -> list[tuple[str, str]]:
        return [(event.name, event.state) for event in self.outputs.events]


@pytest.fixture
def fed(tmp_path: Path):
    made = Fed(tmp_path / "live.mcap")
    with closing(made.outputs):
        yield made


def test_a_killed_process_is_reported_and_restarted_and_recording_continues(fed: Fed, tmp_path: Path, capfd) -> None:
    first, second, third = (tmp_path / name for name in ("live.mcap", "live.2.mcap", "live.3.mcap"))
    second.write_text("another person's")
    until(lambda: first.stat().st_size > 400_000, fed.feed)
    pid = fed.kill()
    until(lambda: fed.outputs.failed, fed.feed)
    assert fed.events() == [("process", FAILED)]
    assert f"process {pid} ended by signal SIGKILL; starting again" in fed.outputs.events[0].text
    kept, taken = first.read_bytes(), fed.taken()
    until(lambda: fed.state() == OK, fed.feed)
    assert fed.events()[-1] == ("record", OK)
    assert fed.outputs.events[-1].text == f"continues in {third}"
    until(lambda: fed.taken() > taken + 50, fed.feed)
    fed.outputs.close()
    assert fed.outputs.failed
    figures = fed.outputs.figures()["record"]
    assert (figures["failures"], figures["finished"], figures["where"]) == (1, True, str(third))
    # nothing is written over, what was recorded can be read, and the new part is whole
    assert (first.read_bytes(), second.read_text()) == (kept, "another person's")
    said: list[str] = []
    before = [pose.t_ns for pose, _ in read_poses(first, warn=said.append)]
    assert len(before) > 50 and len(said) == 1
    after = [pose.t_ns for pose, _ in read_poses(third, warn=said.append)]
    assert len(after) >= 50 and len(said) == 1
    assert after[0] > before[-1]
    assert next(read_mcap(third, {topics.JOINT_CENTRES.name})).topic == topics.JOINT_CENTRES.name
    assert read_notes(third) == notes_of(made_up_rig(), LiveConfig()) | {"part": "2"}
    assert capfd.readouterr() == ("", "")


def lose_second(fed: Fed, folder: Path, spare: Path | None = None) -> None:
    """Remove the folder of a second recording, for which there may be a second place."""
    folder.mkdir()
    fed.outputs.add("second", RecordConfig(path=folder / "second.mcap", spare=spare))
    until(lambda: "second" in fed.outputs.health and fed.taken("second") > 5, fed.feed)
    shutil.rmtree(folder)


def test_after_a_restart_an_output_that_cannot_be_opened_keeps_no_other_closed(fed: Fed, tmp_path: Path) -> None:
    lose_second(fed, tmp_path / "gone")
    fed.kill()
    until(lambda: fed.outputs.failed, fed.feed)
    fed.take_more(20)
    until(lambda: "gone" in fed.outputs.health["second"].text, fed.feed)
    assert (fed.state(), fed.state("second")) == (OK, FAILED)
    # each has a line of its own
    assert {event.name: event.state for event in fed.outputs.events} == {"process": FAILED, "record": OK, "second": FAILED}
    assert fed.events().count(("process", FAILED)) == 1


def test_a_recording_whose_file_is_gone_is_named_and_continues_in_the_second_place(fed: Fed, tmp_path: Path) -> None:
    spare = tmp_path / "spare"
    spare.mkdir()
    lose_second(fed, tmp_path / "gone", spare)
    until(lambda: fed.outputs.health["second"].failures == 1, fed.feed)
    assert "second.mcap: the file is gone" in fed.outputs.health["second"].fault
    until(lambda: fed.state("second") == OK, fed.feed)
    assert fed.outputs.health["second"].where == str(spare / "second.2.mcap")
    fed.take_more(10, "second")
    fed.outputs.close()
    said: list[str] = []
    assert len(list(read_poses(spare / "second.2.mcap", warn=said.append))) > 10 and said == []


def test_a_recording_that_makes_progress_is_finished_at_the_end(fed: Fed, tmp_path: Path, monkeypatch) -> None:
    """It takes longer than an output without progress is waited for."""
    slow = tmp_path / "slow.txt"
    fed.outputs.add("slow", Slow(slow))
    fed.take_more(0, "slow")
    monkeypatch.setattr(outputs_module, "END_S", 0.5)
    for _ in range(40):
        fed.feed()
    fed.outputs.close()
    assert not fed.outputs.failed
    assert slow.read_text().endswith("closed")


def test_a_process_that_exits_early_is_a_failure(fed: Fed) -> None:
    fed.take_more(0)
    fed.kill(signal.SIGSTOP)
    fed.outputs.close()
    assert fed.outputs.failed
    assert "ended before the outputs had finished" in fed.outputs.events[-1].text


@pytest.mark.parametrize("newest", [False, True])
def test_messages_are_sent_in_batches_unless_an_output_needs_the_newest(fed: Fed, monkeypatch, newest: bool) -> None:
    sent: list[list[LivePose]] = []

    def send(batch: list[LivePose], wait_s: float = 0.0) -> bool:
        sent.append(batch)
        return True

    fed.outputs.poll()
    monkeypatch.setattr(fed.outputs._worker, "send", send)
    monkeypatch.setattr(OutputProcess, "wants_newest", newest)
    now_s = time.monotonic()
    for i in range(40):
        monkeypatch.setattr(time, "monotonic", lambda i=i: now_s + 0.01 * i)
        fed.outputs.offer(replace(POSE, stages_ns={"i": i}))
    monkeypatch.undo()
    monkeypatch.setattr(fed.outputs._worker, "send", send)
    fed.outputs.poll()
    monkeypatch.undo()
    assert [message.stages_ns["i"] for bundle in sent for message in bundle] == list(range(40))
    assert len(sent) == 40 if newest else len(sent) <= 10


def test_an_output_is_added_and_removed_while_the_session_runs(fed: Fed, tmp_path: Path) -> None:
    second = tmp_path / "second.mcap"
    fed.outputs.offer(LiveNames(t_ns=POSE.pose.t_ns, names={0: "Ada"}))
    fed.take_more(0)
    fed.outputs.add("second", RecordConfig(path=second))
    fed.take_more(20, "second")
    fed.outputs.remove("second")
    # it stays in the list until its file is whole
    until(lambda: "second" not in fed.outputs.health, fed.feed)
    fed.take_more(5)
    said: list[str] = []
    assert len(list(read_poses(second, warn=said.append))) > 20 and said == []
    # what a recording must have seen before all poses came to the later one, too
    assert next(read_mcap(second, {topics.JOINT_CENTRES.name})).topic == topics.JOINT_CENTRES.name
    assert names_from_message(next(read_mcap(second, {topics.NAMES.name})).msg) == {0: "Ada"}
    assert not fed.outputs.failed and fed.state() == OK and fed.events() == []


def test_an_output_that_cannot_be_opened_is_reported_before_the_session_starts(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    outputs = outputs_to(tmp_path / "no" / "live.mcap")
    refusal(InputError, "cannot be written", outputs.wait_ready)
    outputs.close()


def test_a_full_disk_is_reported_and_recording_continues_after_space_is_freed(small_disk: Callable[[int], Path], capfd) -> None:
    disk = small_disk(12)
    ballast = disk / "ballast"
    ballast.write_bytes(bytes(11 * 2**20))
    fed = Fed(disk / "live.mcap")
    with closing(fed.outputs):
        until(lambda: fed.state() == FAILED, fed.feed)
        assert fed.events() == [("record", FAILED)]
        assert fed.outputs.events[0].text == f"{disk / 'live.mcap'}: No space left on device"
        [line] = health_lines(LiveHealth(t_ns=0, cameras={}, outputs=fed.outputs.health))
        assert (line.name, line.level) == ("posefuse: output record", 2) and "No space" in line.message
        ballast.unlink()
        until(lambda: fed.state() == OK, fed.feed)
        until(lambda: fed.taken() > fed.count // 2, fed.feed)
    assert fed.outputs.failed
    assert sorted(path.name for path in disk.iterdir()) == ["live.2.mcap", "live.mcap"]
    [line] = health_lines(LiveHealth(t_ns=0, cameras={}, outputs=fed.outputs.health))
    assert line.level == 1 and "continues after 1 failures, the last" in line.message
    said: list[str] = []
    assert len(list(read_poses(disk / "live.mcap", warn=said.append))) > 50
    assert len(said) == 1
    assert list(read_poses(disk / "live.2.mcap", warn=said.append)) and len(said) == 1
    assert capfd.readouterr() == ("", "")
