"""Ten minutes of sabotage of one live session with all its outputs: it continues to the end, and nothing recorded is lost."""

import contextlib
import json
import os
import random
import re
import shutil
import signal
import socket
import threading
import time
from pathlib import Path

import pytest
from live_session import FAULTY, PATIENCE_S, Live, command, fill
from marked import ON_LINUX, left, marked, new_mark
from running import Running, python

from bench import two_machines
from posefuse.cli.stopping import NO_PERSON_CODE
from posefuse_ros.bags import read_poses

pytest.importorskip("cyclonedds", reason="the extra `ros` is not installed")

pytestmark = [pytest.mark.slow, pytest.mark.realtime, ON_LINUX]

LASTS_S = float(os.environ.get("POSEFUSE_STRESS_S", "600"))
# of this time: the disk is full, has room again, and the folder of the recording is removed
FULL, FREED, REMOVED, CALM = 0.40, 0.51, 0.65, 0.95
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP, signal.SIGCONT)
EVERY_S, STOPPED_S, DISK_MB, MOST_MB = (3.0, 20.0), 4.0, 200, 150
DOMAIN = 60 + os.getpid() % 40
# what the DDS standard lets others know of a domain
DDS_PORTS = [7400 + 250 * DOMAIN + offset for offset in (0, 1, 10, 11, 12, 13)]


def flood(over: threading.Event) -> None:
    """Datagrams of random bytes to the ports of the session, all the time."""
    rng = random.Random(1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while not over.wait(0.002):
            body = rng.randbytes(rng.choice((1, 20, 200, 1400)))
            with contextlib.suppress(OSError):
                sender.sendto(rng.choice((b"RTPS\x02\x01", b"")) + body, ("127.0.0.1", rng.choice(DDS_PORTS)))


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


def readable(folder: Path) -> int:
    """Poses in the recordings of a folder; each must be readable up to where it was cut off."""
    return sum(1 for path in folder.glob("*.mcap") for _ in read_poses(path, warn=str))


def test_ten_minutes_of_kills_stops_floods_a_full_disk_and_a_removed_folder(
    demo_session: Path, small_disk, tmp_path: Path
) -> None:
    disk, spare, kept, (mark, environment) = small_disk(DISK_MB), tmp_path / "spare", tmp_path / "kept", new_mark()
    folder, filler, over = disk / "session", disk / "filler", threading.Event()
    threading.Thread(target=flood, args=(over,)).start()
    folder.mkdir()
    spare.mkdir()
    outputs = ["--ros", "--local-only", "--domain", str(DOMAIN), "--osc", "127.0.0.1:9", "--json-udp", "127.0.0.1:9"]
    outputs += ["--record", str(folder / "s.mcap"), "--set", f"outputs.record.spare={spare}", "--groups", "2"]
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
            memory.append(int(re.findall(r"VmRSS:\s+(\d+)", Path(f"/proc/{live.process.pid}/status").read_text())[0]) / 1024)
            time.sleep(0.2)
        parts = readable(kept), readable(spare)
        live.process.send_signal(signal.SIGINT)
        _, said = live.ended(1)
    finally:
        live.process.kill()
        over.set()
    assert left(mark) == []
    first = memory[len(memory) // 5]
    assert min(parts) > 0
    assert memory[-1] - first < MOST_MB
    assert said.count("\n") < 30 * sabotage.count, "garbage from the network is not on the terminal"


@pytest.mark.parametrize("by_s", [-7200, 7200])
def test_sessions_and_nodes_continue_when_the_clock_of_the_machine_is_set(demo_session: Path, tmp_path: Path, by_s: int) -> None:
    set_clock, site = tmp_path / "set", tmp_path / "site"
    site.mkdir()
    shutil.copyfile(Path(__file__).parents[1] / "support" / "set_clock.py", site / "sitecustomize.py")
    path = os.pathsep.join(filter(None, [str(site), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "CLOCK_SET_BY": str(set_clock), "CLOCK_SET_S": str(by_s), "PYTHONPATH": path}
    network, live = ["--local-only", "--domain", str(DOMAIN + 1)], command(demo_session, "--loop", "10")
    node, (rig, *cameras) = [*live[:3], "node"], live[4:]
    commands = (live, [*node, "camera", rig, *cameras, *network], [*node, "fusion", rig, *network])
    with contextlib.ExitStack() as stack:
        runs = [stack.enter_context(Running(one, env=environment)) for one in commands]
        for run in (runs[0], runs[2]):
            run.err.wait_for(": ok", PATIENCE_S)
        set_clock.touch()
        time.sleep(8.0)
        for run in (runs[2], runs[1], runs[0]):
            run.process.send_signal(signal.SIGINT)
            _, err = run.finished(PATIENCE_S)
            # on a busy machine a person may not be tracked, and frames come seconds late, as if their clock was off by that
            assert run.process.returncode in (0, NO_PERSON_CODE) and "Traceback" not in err, err
            assert all(abs(float(off_s)) < 60 for off_s in re.findall(r"its clock is (\S+) s off", err)), err


def test_a_cut_link_and_a_clock_that_is_off_are_survived_and_found() -> None:
    if reason := two_machines.why_not():
        pytest.skip(reason)
    program = str(FAULTY.with_name("live_faults.py"))
    command = [program, "--detector", "oracle", "--only", "link: cut", "link: clock"]
    done = python(*command)
    assert done.returncode == 0, done.stderr
    cut, clock = json.loads(done.stdout)["Faults"]
    assert (cut["named"], cut["blamed_wrongly"]) == ("silent", [])
    assert None not in (cut["named_s"], cut["back_s"])
    assert cut["unused_s"] > 9 and cut["shown_share"] > 0.99
    assert clock["clock_ms"] == pytest.approx(50, abs=5)
