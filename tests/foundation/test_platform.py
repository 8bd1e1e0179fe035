"""What differs between systems, asked for as each of them would answer."""

import os
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import av
import pytest
from checks import refusal

from posefuse.core import ConfigError
from posefuse.foundation import platform


def test_cores_come_from_the_newest_question_the_system_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 3, 5}, raising=False)
    monkeypatch.setattr(os, "process_cpu_count", lambda: 2, raising=False)
    assert platform.usable_cores() == 2
    monkeypatch.delattr(os, "process_cpu_count")
    assert platform.usable_cores() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    assert platform.usable_cores() == 64
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert platform.usable_cores() == 1


def test_a_user_without_a_home_folder_is_one_line_that_names_the_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    """As one of a container that no account belongs to: each command ended with a trace."""

    def unknown(path: str) -> str:
        raise RuntimeError("could not determine the home directory for '~/.cache', set an absolute HOME or XDG variable")

    monkeypatch.delenv("POSEFUSE_CACHE", raising=False)
    monkeypatch.setattr("platformdirs.user_cache_dir", lambda *_, **__: unknown("~/.cache"))
    refusal(ConfigError, "no home folder; set HOME or POSEFUSE_CACHE", platform.default_cache_dir)
    refusal(ConfigError, "set HOME or XDG_STATE_HOME", platform.home_folder, lambda *_, **__: unknown("~"), "XDG_STATE_HOME")


def test_a_priority_that_may_not_be_changed_stops_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise PermissionError

    asked = []
    monkeypatch.setattr(os, "nice", asked.append, raising=False)
    platform.lower_priority(7)
    assert asked == [7]
    monkeypatch.setattr(os, "nice", refused)
    platform.lower_priority(7)
    monkeypatch.setattr(os, "setpriority", refused, raising=False)
    platform.lower_thread_priority(7)
    monkeypatch.setattr(os, "sched_setscheduler", refused, raising=False)
    with platform.punctual():
        pass


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere threads have the priority of their process")
def test_a_thread_gives_way_to_the_others_of_its_process_by_so_many_steps() -> None:
    mine = os.getpriority(os.PRIO_PROCESS, 0)
    found: list[int] = []

    def work() -> None:
        platform.lower_thread_priority(3)
        found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id()))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join(timeout=60)
    assert not thread.is_alive()
    assert found == [min(19, mine + 3)]
    assert os.getpriority(os.PRIO_PROCESS, 0) == mine


@pytest.mark.parametrize(
    ("system", "camera"),
    [
        ("linux", ("v4l2", "/dev/video0")),
        ("darwin", ("avfoundation", "/dev/video0")),
        ("win32", ("dshow", "video=/dev/video0")),
    ],
)
def test_cameras_by_system(monkeypatch: pytest.MonkeyPatch, system: str, camera: tuple) -> None:
    monkeypatch.setattr(platform, "sys", SimpleNamespace(platform=system))
    assert (platform.usb_camera_format(), platform.usb_camera_address("/dev/video0")) == camera
    assert platform.usb_camera_address(camera[1]) == camera[1]


@pytest.mark.parametrize(("system", "opened"), [("win32", "Front camera"), ("darwin", "@device_pnp_1")])
def test_cameras_are_listed_by_what_opens_them(monkeypatch: pytest.MonkeyPatch, system: str, opened: str) -> None:
    about = (("@device_pnp_1", "Front camera", ["video"]), ("@device_cm_2", "Microphone", ["audio"]))
    found = [SimpleNamespace(name=name, description=said, media_types=types) for name, said, types in about]
    monkeypatch.setattr(av, "enumerate_input_devices", lambda name: found)
    monkeypatch.setattr(platform, "sys", SimpleNamespace(platform=system))
    assert platform.usb_cameras() == {opened: "Front camera"}


def test_a_camera_of_linux_is_listed_by_the_node_of_its_images(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    dev, v4l = tmp_path / "dev", tmp_path / "sys"
    dev.mkdir()
    for node, index in (("video0", "0"), ("video1", "1"), ("video2", "")):
        (dev / node).touch()
        (v4l / node).mkdir(parents=True)
        # of the last one the system says nothing
        for name, text in {"index": index, "name": "BRIO"}.items() if index else ():
            (v4l / node / name).write_text(f"{text}\n")
    monkeypatch.setattr(platform, "sys", SimpleNamespace(platform="linux"))
    monkeypatch.setattr(platform, "DEVICES", dev)
    monkeypatch.setattr(platform, "V4L", v4l)
    assert platform.usb_cameras() == {f"{dev}/video0": "BRIO", f"{dev}/video2": f"{dev}/video2"}


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux says how much memory a process has held")
def test_memory_of_processes_adds_up() -> None:
    own = platform.peak_memory_mb([os.getpid()])
    assert own > 1
    assert platform.peak_memory_mb([os.getpid()] * 2) >= 2 * own
    assert platform.peak_memory_mb([2**30]) != platform.peak_memory_mb([2**30])
