"""No command looks up a name, connects to another machine, or writes into the user's home; every process is watched."""

import os
import shutil
import urllib.request
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

import network_log
import pytest
from running import python

from posefuse.detection.build import DetectorChoice
from posefuse.foundation.platform import default_cache_dir
from posefuse.realtime.networks import fetch_networks
from tools.studio_server import cookie, free_port, server

PATIENCE_S = 300.0


class Watch:
    """Runs commands in an empty home and keeps what they ask of the network."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.home, self.log = folder / "home", folder / "network.log"
        self.home.mkdir()
        shutil.copyfile(network_log.__file__, folder / "sitecustomize.py")
        monkeypatch.setenv("POSEFUSE_CACHE", str(default_cache_dir()))
        monkeypatch.setenv("POSEFUSE_TEST_NETWORK_LOG", str(self.log))
        monkeypatch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)
        for name in ("HOME", "USERPROFILE", "APPDATA", "LOCALAPPDATA"):
            monkeypatch.setenv(name, str(self.home))
        # machines of a CI are recognised by these, and what would report home on a user's computer is silent there
        for name in [name for name in os.environ if name.startswith("XDG_") or name in {"CI", "TF_BUILD", "JENKINS_URL"}]:
            monkeypatch.delenv(name)

    def posefuse(self, *words: str) -> None:
        """Run a command that succeeds, and is quiet."""
        done = python("-m", "posefuse", *words, limit_s=PATIENCE_S)
        assert done.returncode == 0, done.stderr
        self.assert_quiet()

    def assert_quiet(self) -> None:
        """Nothing was asked for, nothing was written."""
        assert not self.log.exists(), self.log.read_text(encoding="utf-8")
        assert not [path for path in self.home.rglob("*") if path.is_file()]


@pytest.fixture
def watch(tmp_path: Path, models: None, monkeypatch: pytest.MonkeyPatch) -> Watch:
    # those `live` chooses between, too: npm, which fetches one, keeps files of its own in the home
    fetch_networks(DetectorChoice())
    return Watch(tmp_path, monkeypatch)


def live(session: Path) -> Sequence[str]:
    videos = [f"--source={path.stem}=video:{path}" for path in sorted((session / "videos").iterdir())]
    return ("live", str(session / "rig.toml"), *videos, "--duration", "2")


@pytest.mark.parametrize(
    "program",
    [
        "import socket; socket.getaddrinfo('posefuse.invalid', 443)",
        "import socket; socket.gethostbyname('posefuse.invalid')",
        "import socket; socket.socket(socket.AF_INET, socket.SOCK_DGRAM).sendto(b'', ('192.0.2.1', 9))",
        "import subprocess, sys; subprocess.run([sys.executable, '-c', \"import socket; socket.getaddrinfo('a.invalid', 1)\"])",
        "import openvino",
    ],
)
def test_the_watch_sees_what_a_process_asks_for(watch: Watch, program: str) -> None:
    python("-c", program)
    with pytest.raises(AssertionError):
        watch.assert_quiet()


def test_demo_and_report(watch: Watch, tmp_path: Path) -> None:
    watch.posefuse("demo", "--out", str(tmp_path / "result"))
    watch.posefuse("report", str(tmp_path / "result"))


def test_doctor(watch: Watch) -> None:
    # importing it here would write into the home, too
    if find_spec("onnxruntime") is None:
        pytest.skip("the extra onnx is not installed")
    watch.posefuse("doctor")


def test_live(watch: Watch, demo_session: Path) -> None:
    watch.posefuse(*live(demo_session))


def test_batch(watch: Watch, demo_session: Path, tmp_path: Path) -> None:
    shutil.copytree(demo_session, tmp_path / "study" / "P01" / "walk1", ignore=shutil.ignore_patterns("truth"))
    watch.posefuse("batch", str(tmp_path / "study"), "--out", str(tmp_path / "results"), "--set", "end_s=0.2")


def test_simulate(watch: Watch, demo_session: Path, tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="the extra sim is not installed")
    scene = (demo_session / "scene.yaml").read_text(encoding="utf-8").replace("duration_s: 10.0", "duration_s: 0.1")
    (tmp_path / "scene.yaml").write_text(scene.replace("- 640", "- 64").replace("- 480", "- 48"), encoding="utf-8")
    watch.posefuse("simulate", str(tmp_path / "scene.yaml"), "--out", str(tmp_path / "made"))


def test_studio(watch: Watch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("nicegui", reason="the extra studio is not installed")
    # what a laboratory may have set for its own programs: FastAPI would send every address that is opened, or warn that it cannot
    monkeypatch.setenv("FASTAPI_OTEL_AUTO_CONFIGURE", "true")
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", "http://192.0.2.1:4318")
    port, log = free_port(), tmp_path / "printed.txt"
    with server(tmp_path, port, log=log):
        known = "; ".join(f"{name}={token}" for name, token in cookie(port).items())
        page = urllib.request.Request(f"http://127.0.0.1:{port}", headers={"Cookie": known})
        assert b"posefuse" in urllib.request.urlopen(page, timeout=PATIENCE_S).read()
    watch.assert_quiet()
    assert "telemetry" not in log.read_text(encoding="utf-8")
