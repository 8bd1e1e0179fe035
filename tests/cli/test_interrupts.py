"""Signals to whole commands at moments drawn at random: one line or none, the right exit code, no process left, nothing lost.

The first run of a command is not interrupted: its duration is the range of the moments, and its exit code is what the run after
each interruption must end with.
"""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from live_session import until
from marked import MARK, ON_LINUX, left, new_mark
from studies import write_session

from posefuse.core import Rig
from posefuse.formats.rig import write_rig
from posefuse_studio.jobs import Jobs
from posefuse_studio.workspace import StudioWorkspace

pytestmark = [pytest.mark.slow, ON_LINUX]

CODES = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129, signal.SIGKILL: -9}
LIMIT_S, FIRST_S = 240.0, 0.1
DEMO = Path(__file__).resolve().parents[2] / "examples" / "demo"
ORACLE = f"--set detector.name=oracle --set detector.options.truth={DEMO / 'truth' / 'truth.npz'}"
SIM, NODE = f"{DEMO}/rig.toml --source sim:{DEMO} --loop 10 {ORACLE}", f"--local-only --domain {20 + os.getpid() % 80}"
SCENE = """duration_s: 0.5
rate_hz: 20.0
cameras: {kind: ring, count: 2, radius_m: 4.2, height_m: 2.1, image: {size_px: [160, 120], horizontal_fov_deg: 62.0}}
people: [{motion: {kind: walk, path: {shape: circle, radius_m: 1.3}}}]
"""
# {in}: inputs, {out}: a path that each run into it continues, or a new one where the command has a --duration; for `track` see
# `test_interruptions`, for `live` `test_session_outputs` and `test_stress`
COMMANDS = {
    "batch": "batch {in}/study --out {out} --outputs trc --no-report --jobs 2",
    "simulate": "simulate {in}/scene.yaml --out {out} --workers 2",
    "calibrate person": "calibrate person cam00={in}/study/P01/slow/pose2d/cam00 cam01={in}/study/P01/slow/pose2d/cam01 "
    "--intrinsics {in}/study/P01/rig.toml --rate 50 --height-m 1.8 --out {out}",
    "record": "record --source cam00=video:{demo}/videos/cam00.mp4 --out {out} --duration 4",
    "teleoperate": f"teleoperate {SIM} --deadman web --record {{out}}.mcap --duration 4",
    "node camera": f"node camera {SIM} {NODE} --duration 4",
    "node fusion": f"node fusion {DEMO}/rig.toml {NODE} --duration 4",
}


@pytest.fixture(scope="module")
def inputs(ring_rig: Callable[..., Rig], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, rig = tmp_path_factory.mktemp("inputs"), ring_rig(3)
    for name in ("fast", "slow"):
        write_session(folder / "study" / "P01" / name, rig)
        (folder / "study" / "P01" / name / "posefuse.toml").write_text("rate_hz = 50.0\n")
    write_rig(folder / "study" / "P01" / "rig.toml", rig)
    (folder / "scene.yaml").write_text(SCENE)
    return folder


@dataclass
class Try:
    """A run of a command and of all processes that it starts, which are found by a mark in their environment."""

    process: subprocess.Popen[bytes]
    log: Path
    mark: str

    def wait(self, limit_s: float = LIMIT_S) -> int:
        return self.process.wait(limit_s)

    def said(self) -> str:
        return self.log.read_text()


def started(words: str, inputs: Path, out: Path) -> Try:
    # Ctrl-C is ignored by what a shell runs in the background, and so by its children
    signal.signal(signal.SIGINT, signal.default_int_handler)
    parts = [part.format(**{"in": inputs, "out": out, "demo": DEMO}) for part in words.split()]
    (mark, environment), log = new_mark(), inputs.parent / f"{inputs.name}.log"
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "posefuse", *parts], stdin=subprocess.DEVNULL, stdout=file, stderr=file,
            start_new_session=True, env=environment,
        )  # fmt: skip
    return Try(process, log, mark)


def tree(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def sent(run: Try, number: signal.Signals) -> None:
    """As a terminal does it, which sends Ctrl-C to all processes of a command."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(run.process.pid, number) if number == signal.SIGINT else run.process.send_signal(number)


@pytest.mark.parametrize("name", COMMANDS)
def test_an_interrupted_command_ends_quietly_and_loses_nothing_and_a_next_run_works(name: str, inputs, tmp_path) -> None:
    words, before, rng = COMMANDS[name], tree(inputs), random.Random(name)
    began_s = time.monotonic()
    whole = started(words, inputs, tmp_path / "whole")
    expected, lasts_s = whole.wait(LIMIT_S), time.monotonic() - began_s
    # the person of these poses does not walk about, and a fusion node alone sees no camera
    assert expected == (name in ("calibrate person", "node fusion")) and "--help" not in whole.said(), whole.said()
    out = tmp_path / "out"
    (tmp_path / "notes.txt").write_text("mine")
    for number, code in CODES.items():
        run, moment_s = started(words, inputs, out), rng.uniform(FIRST_S, 0.9 * lasts_s)
        time.sleep(moment_s)
        sent(run, number)
        where = f"{name}, {number.name} after {moment_s:.2f} of {lasts_s:.2f} s"
        ended = run.wait(LIMIT_S)
        # before the command has begun, Python itself ends; what was done already is done
        assert ended in (code, -number, expected), f"{where}: {ended}: {run.said()}"
        assert "Traceback" not in run.said() and "this is a bug" not in run.said(), f"{where}: {run.said()}"
        assert out.exists() or "is unfinished" not in run.said(), f"{where}: {run.said()}"
        assert left(run.mark) == [], where
        assert tree(inputs) == before and (tmp_path / "notes.txt").read_text() == "mine", where
        # it was interrupted after all had been written
        whole_there = name == "simulate" and (out / "posefuse-folder.json").exists()
        if ended == expected or "--duration" in words or whole_there:
            out = tmp_path / f"after {number.name}"
    again = started(words, inputs, out)
    assert again.wait(LIMIT_S) == expected, again.said()
    assert left(again.mark) == []


@pytest.mark.parametrize("number", CODES)
def test_an_interrupted_job_of_the_studio_is_reported_and_the_next_one_works(
    number: signal.Signals, inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (mark, _), jobs = new_mark(), Jobs(StudioWorkspace(tmp_path))
    monkeypatch.setenv(MARK, mark)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    shutil.copytree(inputs / "study", tmp_path / "study")
    before = tree(tmp_path / "study")
    work = {"study": "study", "out": "results"}
    job = jobs.start("batch", "Study", work)
    time.sleep(random.Random(int(number)).uniform(FIRST_S, 12.0))
    with contextlib.suppress(ProcessLookupError):
        os.killpg(jobs._processes[job.id].pid, number)
    until(lambda: jobs.report(job.id).ended)
    log = (jobs._folder(job.id) / "log.txt").read_text()
    assert "Traceback" not in log, log
    assert left(mark) == []
    assert tree(tmp_path / "study") == before
    again = jobs.start("batch", "Study", work).id
    until(lambda: jobs.report(again).ended)
    assert jobs.report(again).state == "done"


@pytest.mark.parametrize("number", CODES)
def test_an_interrupted_studio_ends_quietly_and_starts_again(number: signal.Signals, inputs: Path, tmp_path: Path) -> None:
    pytest.importorskip("nicegui", reason="the extra `studio` is not installed")
    words = f"studio {tmp_path} --no-open --port {20000 + os.getpid() % 10000}"
    for one in (number, signal.SIGTERM):
        run = started(words, inputs, tmp_path)
        until(lambda run=run: "token=" in run.said() or run.process.poll() is not None)
        time.sleep(random.Random(int(number)).uniform(0.0, 1.0))
        sent(run, one)
        assert run.wait(LIMIT_S) in (0, CODES[one]), run.said()
        assert "Traceback" not in run.said() and left(run.mark) == []
