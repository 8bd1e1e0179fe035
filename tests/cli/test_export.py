"""`posefuse export`: files of other programs from a result and from a live session; one output that fails costs no other."""

import json
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from commands import as_options, error, tracked
from running import python
from studies import SETTINGS, write_session

import posefuse as pf
from posefuse.cli.main import main
from posefuse.core import InputError, Rig
from posefuse.core.live_messages import LivePose, LiveStart
from posefuse.formats.c3d import read_c3d
from posefuse.formats.recording import read_recording
from posefuse.formats.rig import write_rig
from posefuse.outputs.rerun import RerunSink
from posefuse.pipeline.writing import nearby_session, session_of_recording
from posefuse_ros.mcap_output import RecordConfig


def no_rate(_: pf.PoseSequence) -> pf.PoseSequence:
    raise InputError("no rate")


BEGIN_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def result(demo_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tracked(demo_session, tmp_path_factory.mktemp("export") / "result", "trc,c3d")


@pytest.fixture
def live(tmp_path: Path, ring_rig: Callable[..., Rig], result: Path) -> Path:
    """A live session that skipped an output tick, as busy machines do."""
    path, rig, poses = tmp_path / "live.mcap", ring_rig(2), pf.read(result).poses
    output = RecordConfig(path=path).build()
    output.take(LiveStart(t_ns=BEGIN_NS, rig=rig, rate_hz=100.0, clock_offset_ns=0))
    for i in (0, 1, 2, 4, 5, 6):
        pose = poses.at(i)
        output.take(LivePose(pose=pf.Pose3D(**vars(pose) | {"t_ns": BEGIN_NS + i * 10_000_000})))
    output.close()
    return path


def test_the_files_are_those_of_track_and_an_earlier_export_is_replaced(result: Path, tmp_path: Path) -> None:
    out = tmp_path / "files"
    assert main(["export", str(result), "--out", str(out), "--outputs", "csv"]) == 0
    assert main(["export", str(result), "--out", str(out), "--outputs", "trc,c3d"]) == 0
    assert sorted(path.suffix for path in out.iterdir()) == [".c3d", ".json", ".trc"]
    for name in ("pose.trc", "pose.c3d"):
        assert (out / name).read_bytes() == (result / name).read_bytes()
    (out / "mine.txt").write_text("x")
    assert main(["export", str(result), "--out", str(out)]) == 0
    assert [path.read_text() for path in tmp_path.glob("files.replaced-*/mine.txt")] == ["x"]


def test_files_of_the_3d_alone_need_no_detections(result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The largest file of a result, which `report` and `compare` do without, was read for a TRC file, too."""
    small, out = Path(shutil.copytree(result, tmp_path / "small")), tmp_path / "files"
    (small / "observations.npz").unlink()
    assert main(["export", str(small), "--out", str(out)]) == 0
    for name in ("pose.trc", "pose.c3d"):
        assert (out / name).read_bytes() == (result / name).read_bytes()
    line = error(capsys, "export", small, "--out", tmp_path / "more", "--outputs", "trc,overview")
    assert "observations.npz: no such file" in line


def test_a_result_is_never_written_over(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path: path.read_bytes() for path in result.iterdir()}
    error(capsys, "export", result, "--out", result)
    assert {path: path.read_bytes() for path in result.iterdir()} == before


def test_a_live_session_gives_files_with_the_ticks_that_it_skipped(live, tmp_path) -> None:
    out = tmp_path / "files"
    assert main(["export", str(live), "--out", str(out), "--outputs", "trc,c3d"]) == 0
    written = read_c3d(out / "pose.c3d")
    assert written.rate_hz == pytest.approx(100)
    nose = np.full((7, 3), np.nan)
    nose[[0, 1, 2, 4, 5, 6]] = pf.read(live).poses.xyz_world[:, 0, 0]
    np.testing.assert_allclose(written.xyz_world[:, 0], nose, atol=1e-6)


def test_a_live_session_gives_files_and_an_output_that_fails_is_named(live, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr("posefuse.outputs.data_files.evenly_spaced", no_rate)
    out = tmp_path / "files"
    assert main(["export", str(live), "--out", str(out), "--outputs", "trc,c3d", "--json"]) == 1
    printed = capsys.readouterr()
    figures = json.loads(printed.out)
    assert figures["files"] == ["pose.trc"]
    assert figures["failed"]["c3d"] == "no rate"
    assert "output c3d: not written" in " ".join(printed.err.split())
    assert (out / "pose.trc").stat().st_size > 0
    with pytest.warns(UserWarning, match="c3d: not written .no rate"):
        pf.read(live).export(tmp_path / "python", ["trc", "c3d"])
    assert (tmp_path / "python" / "pose.trc").read_bytes() == (out / "pose.trc").read_bytes()


def test_an_export_of_which_nothing_can_be_written_leaves_no_folder(live, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr("posefuse.outputs.data_files.evenly_spaced", no_rate)
    assert "no rate" in error(capsys, "export", live, "--out", tmp_path / "files", "--outputs", "c3d")
    assert "expected at least one of" in error(capsys, "export", live, "--out", tmp_path / "files", "--outputs", "")
    assert not (tmp_path / "files").exists()
    assert "no plug-in 'nothing'" in error(capsys, "export", live, "--out", tmp_path / "files", "--outputs", "trc,nothing")


# --- `posefuse view` shows the session's images where the result does not hold them, and says so where they are not found


@pytest.fixture(scope="module")
def study(demo_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a session ``demo`` and results of a third of a second of it, one next to it and one two folders down."""
    pytest.importorskip("rerun", reason="the extra `viewer` is not installed")
    folder = tmp_path_factory.mktemp("study")
    shutil.copytree(demo_session, folder / "demo")
    tracked(folder / "demo", folder / "result")
    (folder / "out").mkdir()
    shutil.copytree(folder / "result", folder / "out" / "deeper")
    return folder


def images_shown(result: Path, session: Path | None, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether the viewer is given images."""
    listing: list[str] = []

    def listed(path: Path) -> None:
        done = python("-m", "rerun", "rrd", "print", "-vvv", str(path))
        assert done.returncode == 0, done.stderr
        listing.append(done.stdout)

    monkeypatch.setattr("posefuse.outputs.rerun.open_in_viewer", listed)
    assert main(["view", str(result), *([] if session is None else ["--session", str(session)])]) == 0
    return "EncodedImage:blob" in listing[0]


@pytest.mark.parametrize("result", ["result", "out/deeper"])
def test_images_of_a_session_near_the_result_are_shown(study: Path, result: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert nearby_session(read_recording(study / result), study / result).folder == study / "demo"
    assert images_shown(study / result, None, monkeypatch)


def test_a_session_elsewhere_is_named_or_missed(study, demo_session, tmp_path, monkeypatch, capsys) -> None:
    result = Path(shutil.copytree(study / "result", tmp_path / "alone"))
    monkeypatch.chdir(tmp_path)
    assert not images_shown(result, None, monkeypatch)
    assert "without images: no session demo" in " ".join(capsys.readouterr().err.split())
    assert images_shown(result, demo_session, monkeypatch)


def test_an_export_without_its_images_states_so(study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result, out = Path(shutil.copytree(study / "result", tmp_path / "alone")), str(tmp_path / "files")
    words = "without images: no session of this recording is near; name it with --session DIR"
    for options, stated in (("--outputs overlay", True), (f"--outputs overlay --session {study / 'demo'}", False), ("", False)):
        assert main(["export", str(result), "--out", out, *options.split()]) == 0
        assert (words in " ".join(capsys.readouterr().err.split())) == stated


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
    (result / RerunSink.file).write_bytes(b"made before")
    shown: list[bytes] = []
    monkeypatch.setattr("posefuse.outputs.rerun.open_in_viewer", lambda path: shown.append(path.read_bytes()))
    assert main(["view", str(result)]) == 0
    assert shown == [b"made before"]


# --- names of folders and files may have letters of all languages, spaces and brackets, in every command that takes them


@pytest.mark.parametrize("name", ["Käthe Müller [red] (a)", "a b's #1 走 100%"])
def test_a_name_of_any_letters_works_in_every_command(name: str, tmp_path, ring_rig, capsys, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "400")
    study, rig = tmp_path / name, ring_rig(3)
    session = study / "P01" / name
    write_session(session, rig)
    write_rig(session / "rig.toml", rig)
    result, other = tmp_path / f"{name} result", tmp_path / f"{name} other"
    settings = as_options(SETTINGS)
    commands = {
        "track": (session, "--out", result, "--names", name, "--outputs", "trc,csv,overview", *settings),
        "again": (result, "--out", other),
        "export": (result, "--out", tmp_path / f"{name} files", "--outputs", "c3d,trc"),
        "compare": (result, other, "--out", tmp_path / f"{name} comparison"),
        "report": (result, "--fit", "none", "--title", name),
        "batch": (study, "--out", tmp_path / f"{name} study", "--no-report", "--jobs", "1", *settings),
    }
    for command, words in commands.items():
        assert main(["solve" if command == "again" else command, *map(str, words)]) == 0, (command, capsys.readouterr().err)
        shown = capsys.readouterr()
        assert name in shown.out + shown.err, command
        for line in (one for one in (shown.out + shown.err).splitlines() if one.startswith("next: posefuse ")):
            typed = shlex.split(line.removeprefix("next: ").partition("  (")[0])
            assert all(Path(word).exists() for word in typed if word.startswith(str(tmp_path))), line
    assert name in (result / "biomechanics" / "report.html").read_text(encoding="utf-8").replace("&#39;", "'")
    board = tmp_path / f"{name}.pdf"
    assert main(["calibrate", "print", "--cube", "--marker-mm", "60", "--out", str(board)]) == 0 and board.is_file()
    shutil.copy(session / "rig.toml", tmp_path / f"{name}.toml")
    assert main(["track", str(session), "--rig", str(tmp_path / f"{name}.toml"), "--out", str(other), "--force", *settings]) == 0
