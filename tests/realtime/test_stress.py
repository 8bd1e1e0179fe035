"""Ten minutes of sabotage of one live session with all its outputs: it continues to the end, and nothing recorded is lost."""

import contextlib
import json
import os
import random
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from live_session import PATIENCE_S, Live, command, until
from marked import ON_LINUX, left, marked, new_mark
from running import Running
from test_session_outputs import fill

from posefuse.messages.bags import read_poses

pytest.importorskip("mcap")
pytest.importorskip("cyclonedds")

pytestmark = [pytest.mark.slow, pytest.mark.realtime, ON_LINUX]

LASTS_S = float(os.environ.get("POSEFUSE_STRESS_S", "600"))
# of this time: the disk is full, has room again, and the folder of the recording is removed
FULL, FREED, REMOVED, CALM = 0.40, 0.51, 0.65, 0.95
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP, signal.SIGCONT)
EVERY_S, STOPPED_S, DISK_MB, MOST_MB = (3.0, 20.0), 4.0, 200, 150
DOMAIN = 60 + os.getpid() % 40
# what the DDS standard lets others know of a domain
DDS_PORTS = [7400 + 250 * DOMAIN + offset for offset in (0, 1, 10, 11, 12, 13)]


class Flood:
    """Datagrams of random bytes to the ports of the session, all the time; the times of what comes out of it as JSON."""

    def __init__(self) -> None:
        self.sent, self.poses_s, self._stop = 0, list[float](), threading.Event()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.5)
        self._threads = [threading.Thread(target=run) for run in (self._send, self._receive)]
        for thread in self._threads:
            thread.start()

    def _send(self) -> None:
        rng = random.Random(1)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not self._stop.wait(0.002):
                body = rng.randbytes(rng.choice((1, 20, 200, 1400)))
                with contextlib.suppress(OSError):
                    sender.sendto(rng.choice((b"RTPS\x02\x01", b"")) + body, ("127.0.0.1", rng.choice(DDS_PORTS)))
                    self.sent += 1

    def _receive(self) -> None:
        while not self._stop.is_set():
            with contextlib.suppress(TimeoutError):
                self.socket.recv(65536)
                self.poses_s.append(time.monotonic())

    def close(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self.socket.close()

    def longest_gap_s(self) -> float:
        return max((b - a for a, b in zip(self.poses_s, self.poses_s[1:], strict=False)), default=float("nan"))


class Sabotage:
    """Signals to processes of the session drawn at random, at times drawn at random."""

    def __init__(self, root: int, mark: str) -> None:
        self.count, self._root, self._mark, self._rng = 0, root, mark, random.Random(2)
        self._next_s, self._stopped = 0.0, dict[int, float]()

    def step(self, now_s: float) -> None:
        for pid, since_s in list(self._stopped.items()):
            if now_s - since_s > STOPPED_S:
                self._send(pid, signal.SIGCONT)
                del self._stopped[pid]
        if now_s >= self._next_s:
            self._next_s = now_s + self._rng.uniform(*EVERY_S)
            children = sorted(set(marked(self._mark)) - {self._root})
            if children:
                pid, number = self._rng.choice(children), self._rng.choice(SIGNALS)
                self._send(pid, number)
                self.count += 1
                if number == signal.SIGSTOP:
                    self._stopped[pid] = now_s

    def _send(self, pid: int, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, number)


def memory_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/status").read_text().partition("VmRSS:")[2].split()[0]) / 1024


def readable(folder: Path) -> int:
    """Poses in the recordings of a folder; each must be readable up to where it was cut off."""
    return sum(1 for path in folder.glob("*.mcap") for _ in read_poses(path, warn=str))


def test_ten_minutes_of_kills_stops_floods_a_full_disk_and_a_removed_folder(
    demo_session: Path, small_disk: Callable[[int], Path], tmp_path: Path, record_property
) -> None:
    disk, spare, kept, (mark, environment) = small_disk(DISK_MB), tmp_path / "spare", tmp_path / "kept", new_mark()
    folder, filler, flood = disk / "session", disk / "filler", Flood()
    folder.mkdir()
    spare.mkdir()
    outputs = ["--ros", "--local-only", "--domain", str(DOMAIN), "--osc", "127.0.0.1:9", "--set", f"outputs.record.spare={spare}"]
    outputs += ["--json-udp", f"127.0.0.1:{flood.socket.getsockname()[1]}", "--record", str(folder / "s.mcap"), "--groups", "2"]
    live = Live(command(demo_session, "--loop", "10", *outputs), env=environment, start_new_session=True)
    try:
        live.wait_for("cam03: ok")
        begun_s, sabotage, memory = time.monotonic(), Sabotage(live.process.pid, mark), list[float]()
        events = [(FULL, lambda: fill(filler)), (FREED, filler.unlink)]
        events += [(REMOVED, lambda: [shutil.copytree(folder, kept), shutil.rmtree(folder)])]
        while (share := (time.monotonic() - begun_s) / LASTS_S) < 1.0:
            assert live.process.poll() is None, live.ended()[1][-5000:]
            if events and share >= events[0][0]:
                events.pop(0)[1]()
            if share < CALM:
                sabotage.step(time.monotonic())
            memory.append(memory_mb(live.process.pid))
            time.sleep(0.2)
        parts = readable(kept), readable(spare)
        ended_s = time.monotonic()
        live.process.send_signal(signal.SIGINT)
        figures, said = live.ended(1)
        record_property("s from Ctrl-C to the end", f"{time.monotonic() - ended_s:.1f}")
    finally:
        live.process.kill()
        flood.close()
    assert left(mark) == []
    first = memory[len(memory) // 5]
    record_property("signals", sabotage.count)
    record_property("datagrams of random bytes", flood.sent)
    record_property("restarts of camera processes", figures["restarts"])
    record_property("lines on the terminal", said.count("\n"))
    record_property("MB of the session's process at a fifth of the time, and at the end", f"{first:.0f}, {memory[-1]:.0f}")
    record_property("s, the longest time without a JSON message", f"{flood.longest_gap_s():.0f}")
    record_property("poses read from the recordings of the removed folder, and in the second place", f"{parts[0]}, {parts[1]}")
    assert min(parts) > 0
    assert flood.poses_s[-1] > ended_s - 5.0, "the session gives poses to its end"
    assert memory[-1] - first < MOST_MB
    assert said.count("\n") < 30 * sabotage.count, "garbage from the network is not on the terminal"


@pytest.mark.parametrize("by_s", [-7200, 7200])
def test_a_session_does_not_notice_that_the_clock_of_the_machine_is_set(demo_session: Path, tmp_path: Path, by_s: int) -> None:
    set_clock, recording = tmp_path / "set", tmp_path / "a.mcap"
    environment = environment_of(set_clock, by_s)
    live = Live(command(demo_session, "--loop", "10", "--record", str(recording)), env=environment)
    live.wait_for("cam03: ok")
    until(lambda: recording.exists() and recording.stat().st_size > 200_000)
    set_clock.touch()
    size = recording.stat().st_size
    until(lambda: recording.stat().st_size > size + 400_000)
    live.process.send_signal(signal.SIGINT)
    figures, _ = live.ended()
    assert {event["state"] for event in figures["events"]} <= {"opening", "ok", "overload"}
    poses = [pose for pose, _ in read_poses(recording)]
    seen = [pose.t_ns for pose in poses if len(pose.person_id)]
    assert len(seen) > 0.5 * len(poses) and (seen[-1] - poses[0].t_ns) / 1e9 < figures["seconds"] + 1


@pytest.mark.parametrize("by_s", [-7200, 7200])
def test_nodes_continue_when_the_clock_of_the_machine_is_set(demo_session: Path, tmp_path: Path, by_s: int) -> None:
    set_clock, rig = tmp_path / "set", str(demo_session / "rig.toml")
    network, program = (
        ["--local-only", "--domain", str(DOMAIN + 1), "--json"],
        [sys.executable, "-m", "posefuse.cli.main", "node"],
    )
    cameras = command(demo_session, "--loop", "10", *network)[4:]
    with (
        Running([*program, "fusion", rig, *network], env=environment_of(set_clock, by_s)) as fusion,
        Running([*program, "camera", *cameras], env=environment_of(set_clock, by_s)) as node,
    ):
        fusion.err.wait_for("cam03: ok", PATIENCE_S)
        set_clock.touch()
        time.sleep(8.0)
        ended = []
        for one in (fusion, node):
            one.process.send_signal(signal.SIGINT)
            ended.append(one.finished(PATIENCE_S))
            assert one.process.returncode == 0, ended[-1][1]
    figures = json.loads(ended[0][0])
    assert {name: one["state"] for name, one in figures["cameras"].items()} == dict.fromkeys(figures["cameras"], "ok")
    assert sum(figures["strangers"].values()) == 0 and figures["poses_with_people"] > 0.5 * figures["poses"]


def environment_of(set_clock: Path, by_s: int) -> dict[str, str]:
    """Of a process whose clock is set by so much once the file is there."""
    place = set_clock.parent / "site"
    place.mkdir(exist_ok=True)
    shutil.copyfile(Path(__file__).parents[1] / "support" / "set_clock.py", place / "sitecustomize.py")
    path = os.pathsep.join(filter(None, [str(place), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "CLOCK_SET_BY": str(set_clock), "CLOCK_SET_S": str(by_s), "PYTHONPATH": path}
