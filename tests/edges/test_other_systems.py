"""posefuse as Windows and macOS see it: names of the standard library that these lack are gone, in every process."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import other_system
import pytest
from commands import as_options, oracle
from running import python

SYSTEMS = ("win32", "darwin")
PATIENCE_S = 180.0


@pytest.fixture(scope="module")
def disguise(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that Python imports `sitecustomize` from."""
    folder = tmp_path_factory.mktemp("disguise")
    shutil.copyfile(other_system.__file__, folder / "sitecustomize.py")
    return folder


def run(disguise: Path, system: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    paths = [str(disguise), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    return python(*arguments, limit_s=PATIENCE_S, POSEFUSE_TEST_SYSTEM=system, PYTHONPATH=os.pathsep.join(paths))


def figures(done: subprocess.CompletedProcess[str]) -> dict:
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_lists_of_removed_names_match_the_python_documentation() -> None:
    assert {"nice", "sched_getaffinity", "geteuid", "statvfs", "killpg"} <= other_system.lacking("os", "win32")
    assert {"kill", "cpu_count", "replace", "times", "getpid", "access"}.isdisjoint(other_system.lacking("os", "win32"))
    assert {"SIGKILL", "SIGALRM", "SIGHUP"} <= other_system.lacking("signal", "win32")
    assert {"SIGINT", "SIGTERM", "signal", "Signals"}.isdisjoint(other_system.lacking("signal", "win32"))
    assert "AF_UNIX" in other_system.lacking("socket", "win32")
    assert not other_system.names_of("fcntl", "win32") and not other_system.names_of("resource", "win32")
    assert "sched_getaffinity" in other_system.lacking("os", "darwin") and "nice" not in other_system.lacking("os", "darwin")


@pytest.mark.parametrize("code", ["os.sched_getaffinity(0)", "os.nice(0)", "signal.SIGKILL", "socket.AF_UNIX"])
def test_code_that_needs_linux_is_found_in_posefuse_and_ignored_elsewhere(disguise: Path, code: str) -> None:
    program = f"import os, signal, socket; exec(compile({code!r}, 'x', 'eval'), {{**globals(), '__name__': NAME}})"
    caught = run(disguise, "win32", "-c", f"NAME = 'posefuse.somewhere'; {program}")
    assert caught.returncode == 1 and "AttributeError" in caught.stderr and "on win32" in caught.stderr
    assert run(disguise, "win32", "-c", f"NAME = 'elsewhere'; {program}").returncode == 0


def test_a_module_that_needs_linux_is_found(disguise: Path) -> None:
    program = "exec('import fcntl', {**globals(), '__name__': NAME})"
    assert "No module named 'fcntl'" in run(disguise, "win32", "-c", f"NAME = 'posefuse.x'; {program}").stderr
    assert run(disguise, "darwin", "-c", f"NAME = 'posefuse.x'; {program}").returncode == 0


@pytest.mark.parametrize("system", SYSTEMS)
def test_a_recording_is_tracked(disguise: Path, demo_session: Path, tmp_path: Path, system: str) -> None:
    options = ["--end", "0.4", "--outputs", "trc,csv", "--json", *as_options(oracle())]
    command = ["-m", "posefuse.cli.main", "track", str(demo_session), "--out", str(tmp_path / "result"), *options]
    got = figures(run(disguise, system, *command))
    assert got["time_steps"] == 13 and got["people"] == 1


@pytest.mark.parametrize("system", SYSTEMS)
def test_people_are_detected_in_images(disguise: Path, demo_session: Path, tmp_path: Path, system: str, models: None) -> None:
    options = ["--end", "0.2", "--outputs", "", "--json"]
    command = ["-m", "posefuse.cli.main", "track", str(demo_session), "--out", str(tmp_path / "result"), *options]
    assert {one["seen"] for one in figures(run(disguise, system, *command))["camera_fits"].values()} == {1.0}


@pytest.mark.realtime
@pytest.mark.parametrize("system", [SYSTEMS[0], *(pytest.param(one, marks=pytest.mark.slow) for one in SYSTEMS[1:])])
def test_a_live_session_runs_from_files(disguise: Path, demo_session: Path, system: str) -> None:
    sources = [f"--source=cam0{i}=video:{demo_session / 'videos' / f'cam0{i}.mp4'}" for i in range(4)]
    options = ["--duration", "4", "--loop", "10", "--json-udp", "127.0.0.1:9", "--groups", "2", "--json", *as_options(oracle())]
    command = ["-m", "posefuse.cli.main", "live", str(demo_session / "rig.toml"), *sources, *options]
    got = figures(run(disguise, system, *command))
    assert got["poses"] > 100 and got["restarts"] == 0
    assert all(camera["used"] > 0 for camera in got["cameras"].values())


@pytest.mark.parametrize("system", SYSTEMS)
def test_every_module_of_posefuse_can_be_imported(disguise: Path, system: str) -> None:
    program = """
import importlib, pkgutil, posefuse
failed = {}
for module in pkgutil.walk_packages(posefuse.__path__, "posefuse."):
    try:
        importlib.import_module(module.name)
    except ImportError as error:
        if "on " in str(error) and (error.name or "") in ("resource", "fcntl", "pwd", "grp", "termios"):
            failed[module.name] = str(error)
assert not failed, failed
"""
    done = run(disguise, system, "-c", program)
    assert done.returncode == 0, done.stderr
