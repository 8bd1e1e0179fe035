"""A process with a channel: how it dies is said, it is started again later and later, and it never outlives its parent."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from running import Running

from posefuse.foundation.channel import Channel
from posefuse.foundation.worker import Worker

PATIENCE_S = 60.0
posix = pytest.mark.skipif(sys.platform == "win32", reason="signals")


def echo(channel: Channel, *first: object) -> None:
    """Sends its arguments, then back whatever comes; `exit` ends it with status 3."""
    channel.send(first)
    while channel.wait(PATIENCE_S):
        message = channel.receive()
        if message == "exit":
            os._exit(3)
        if message == "variable":
            message = os.environ.get("POSEFUSE_TEST")
        if message is not None:
            channel.send(message, PATIENCE_S)


def deaf(channel: Channel) -> None:
    """Reads nothing and never ends."""
    channel.send("ready")
    time.sleep(PATIENCE_S)


def answer(worker: Worker) -> object:
    end_s = time.monotonic() + PATIENCE_S
    while worker.running and time.monotonic() < end_s:
        worker.wait(1.0)
        if (message := worker.receive()) is not None:
            return message
    return None


def test_a_time_in_which_the_parent_was_stopped_is_no_silence_of_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """A container that was paused for 12 s: camera processes were called hung and killed, and their videos ended."""
    worker = Worker(deaf)
    worker.start()
    now_s = [worker.started_s]
    monkeypatch.setattr("posefuse.foundation.worker.time.monotonic", lambda: now_s[0])
    silent_s = []
    for step_s in (0.0, *[0.25] * 40, 12.0, *[0.25] * 8):
        now_s[0] += step_s
        silent_s.append(worker.silent_s())
    monkeypatch.undo()
    worker.end(0.0)
    assert (silent_s[40], silent_s[41], silent_s[-1]) == pytest.approx((10.0, 0.0, 2.0))


def test_arguments_and_messages_of_any_size_come_through_and_the_environment_is_its_own() -> None:
    worker = Worker(echo, {"POSEFUSE_TEST": "set"})
    assert not worker.send(1) and worker.receive() is None and worker.due()
    worker.start("a", 2)
    assert answer(worker) == ("a", 2)
    assert worker.send(bytes(5_000_000), PATIENCE_S) and answer(worker) == bytes(5_000_000)
    assert worker.send("variable") and answer(worker) == "set" and "POSEFUSE_TEST" not in os.environ
    pid = worker.pid
    worker.end(0.0)
    worker.end(0.0)
    assert (worker.running, worker.deaths, worker.send(1)) == (False, 0, False)
    assert sys.platform != "linux" or not Path(f"/proc/{pid}").exists()


def test_how_it_ended_is_said_and_it_is_due_again_later_and_later(monkeypatch: pytest.MonkeyPatch) -> None:
    worker, waits = Worker(echo), []
    worker.start()
    assert answer(worker) == ()
    worker.send("exit")
    assert answer(worker) is None and worker.trouble == f"process {worker.pid} ended with status 3"
    for _ in range(8):
        worker.fail("hung")
        waits.append(worker._again_s - time.monotonic())
    assert [round(wait) for wait in waits] == sorted(round(wait) for wait in waits)
    assert waits[0] < 0.5 and 9 < waits[-1] <= 10 and not worker.due()
    # one that had worked for a while has a new trouble
    worker.started_s -= 60
    worker.fail("hung")
    assert worker._again_s - time.monotonic() < 0.3 and worker.deaths == 10
    later_s = time.monotonic() + 1
    monkeypatch.setattr(time, "monotonic", lambda: later_s)
    assert worker.due()
    monkeypatch.undo()
    worker.start()
    assert answer(worker) == () and worker.starts == 2
    worker.end(0.0)


@posix
def test_it_leaves_requests_to_its_parent_and_a_kill_is_named() -> None:
    worker = Worker(echo)
    worker.start()
    assert answer(worker) == () and os.getpgid(worker.pid) != os.getpgid(0)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        os.kill(worker.pid, number)
    assert worker.send("still there") and answer(worker) == "still there"
    os.kill(worker.pid, signal.SIGKILL)
    assert answer(worker) is None
    assert (worker.trouble, worker.deaths) == (f"process {worker.pid} ended by signal SIGKILL", 1)
    worker.end(0.0)


@posix
def test_one_that_does_not_end_is_killed() -> None:
    worker = Worker(deaf)
    worker.start()
    assert answer(worker) == "ready"
    worker.end(0.1)
    with pytest.raises(ProcessLookupError):
        os.kill(worker.pid, 0)


class SlowToDie:
    """A process that a machine with no time to spare has not ended yet."""

    returncode = None
    kills = 0

    def kill(self) -> None:
        self.kills += 1

    def poll(self) -> None: ...

    def wait(self, timeout_s: float) -> None:
        raise subprocess.TimeoutExpired("x", timeout_s)


def test_one_that_is_still_dying_is_no_error_and_is_started_again_later() -> None:
    worker = Worker(echo)
    worker.channel, other = Channel.pair()
    worker._process, worker.running = SlowToDie(), True
    worker.fail("hung")
    worker._again_s = 0.0
    assert worker._process.kills == 1 and not worker.due()
    worker.end(0.0)
    assert worker._process.kills == 2
    other.close()


@posix
def test_it_ends_when_its_parent_is_killed() -> None:
    script = (
        "import sys, time; sys.path[:0] = sys.argv[1:]; from test_worker import Worker, echo, answer; worker = Worker(echo); "
        "worker.start(); answer(worker); print(worker.pid, flush=True); time.sleep(60)"
    )
    here = Path(__file__).parent
    with Running([sys.executable, "-c", script, str(here), str(here.parent / "support")]) as parent:
        pid = int(parent.out.wait_for(r"\d+")[0])
    end_s = time.monotonic() + PATIENCE_S
    with contextlib.suppress(ProcessLookupError):
        while time.monotonic() < end_s:
            os.kill(pid, 0)
            time.sleep(0.02)
    assert time.monotonic() < end_s
