"""A study on a Dask cluster: a real scheduler and two workers on the loopback, one of which is killed in the middle."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from studies import SETTINGS, write_session

import posefuse as pf
from posefuse.core import Rig
from posefuse.formats.rig import write_rig

distributed = pytest.importorskip("distributed")
TRIALS = 6


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    place = f"tcp://127.0.0.1:{port}"
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    worker = ["worker", place, "--no-nanny", "--nthreads", "1", "--no-dashboard", "--local-directory", str(tmp_path)]
    with ExitStack() as stack, (tmp_path / "dask.log").open("w") as log:
        for arguments in (scheduler, worker, worker):
            command = [sys.executable, "-c", "import sys; from dask.__main__ import main; sys.exit(main())", *arguments]
            process = stack.enter_context(subprocess.Popen(command, stdout=log, stderr=log))
            stack.callback(process.kill)
        with distributed.Client(place, timeout=60, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        yield place


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(address: str, ring_rig: Callable[..., Rig], tmp_path: Path) -> None:
    study, rig = tmp_path / "study", ring_rig(3)
    for i in range(TRIALS):
        write_session(study / f"P{i}" / "walk", rig)
    write_rig(study / "rig.toml", rig)
    killed: list[int] = []

    with distributed.Client(address, timeout=60, set_as_default=False) as watcher:
        pids = watcher.run(os.getpid)

        def kill_one(stage: str, done: int, total: int | None, message: str = "") -> None:
            if stage == "trials" and done >= 1 and not killed:
                busy = [worker for worker, tasks in watcher.processing().items() if tasks]
                killed.append(pids[busy[0]])
                os.kill(killed[0], signal.SIGKILL)

        found = pf.batch(
            study, tmp_path / "out", formats=("trc",), report=False, scheduler=address, settings=SETTINGS, progress=kill_one
        )
        assert len(watcher.scheduler_info()["workers"]) == 1
    assert killed
    assert not found.failed
    assert len(found.rows()) == TRIALS
    assert all(len(pf.read(tmp_path / "out" / f"P{i}" / "walk").poses) for i in range(TRIALS))
