"""`posefuse view` shows the session's images where the result does not hold them, and says so where they are not found."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from posefuse.cli.main import main
from posefuse.core import InputError
from posefuse.formats.recording import read_recording
from posefuse.outputs.rerun import FILE
from posefuse.pipeline.writing import nearby_session, session_of_recording

pytest.importorskip("rerun", reason="the extra `viewer` is not installed")


@pytest.fixture(scope="module")
def study(demo_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a session ``demo`` and results of a third of a second of it, one next to it and one two folders down."""
    folder = tmp_path_factory.mktemp("study")
    shutil.copytree(demo_session, folder / "demo")
    truth = demo_session / "truth" / "truth.npz"
    options = ("--set", "detector.name=oracle", "--set", f"detector.options.truth={truth}", "--end", "0.3", "--outputs", "")
    assert main(["track", str(folder / "demo"), "--out", str(folder / "result"), *options]) == 0
    (folder / "out").mkdir()
    shutil.copytree(folder / "result", folder / "out" / "deeper")
    return folder


def images_shown(result: Path, session: Path | None, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether the viewer is given images."""
    listing: list[str] = []

    def listed(path: Path) -> None:
        command = [sys.executable, "-m", "rerun", "rrd", "print", "-vvv", str(path)]
        listing.append(subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout)

    monkeypatch.setattr("posefuse.outputs.rerun.open_in_viewer", listed)
    assert main(["view", str(result), *([] if session is None else ["--session", str(session)])]) == 0
    return "EncodedImage:blob" in listing[0]


@pytest.mark.parametrize("result", ["result", "out/deeper"])
def test_images_of_a_session_near_the_result_are_shown(study: Path, result: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert nearby_session(read_recording(study / result), study / result).folder == study / "demo"
    assert images_shown(study / result, None, monkeypatch)


def test_a_session_elsewhere_is_named_or_missed(
    study: Path, demo_session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    result = Path(shutil.copytree(study / "result", tmp_path / "alone"))
    monkeypatch.chdir(tmp_path)
    assert not images_shown(result, None, monkeypatch)
    assert "without images: no session demo" in " ".join(capsys.readouterr().err.split())
    assert images_shown(result, demo_session, monkeypatch)


def test_another_session_is_refused(study: Path, tmp_path: Path) -> None:
    other = Path(shutil.copytree(study / "demo", tmp_path / "demo"))
    videos = other / "videos"
    (videos / "cam00.mp4").rename(videos / "cam00_again.mp4")
    recording = read_recording(study / "result")
    with pytest.raises(
        InputError, match=r"not the session of this result: camera cam00 was made from cam00\.mp4, here .*cam00_ag"
    ):
        session_of_recording(recording, other)
    assert nearby_session(recording, tmp_path / "result") is None


def test_a_stored_view_is_shown_as_it_is(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = Path(shutil.copytree(study / "result", tmp_path / "stored"))
    (result / FILE).write_bytes(b"made before")
    shown: list[bytes] = []
    monkeypatch.setattr("posefuse.outputs.rerun.open_in_viewer", lambda path: shown.append(path.read_bytes()))
    assert main(["view", str(result)]) == 0
    assert shown == [b"made before"]
