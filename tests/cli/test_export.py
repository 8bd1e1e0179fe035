"""`posefuse export`: files of other programs from a result and from a live session; one output that fails costs no other."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

import posefuse as pf
from posefuse.cli.main import main
from posefuse.core import Rig
from posefuse.core.live_messages import LivePose, LiveStart
from posefuse_ros.record import RecordConfig

BEGIN_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def result(demo_session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("export") / "result"
    truth = demo_session / "truth" / "truth.npz"
    oracle = ("--set", "detector.name=oracle", "--set", f"detector.options.truth={truth}")
    assert main(["track", str(demo_session), "--out", str(out), *oracle, "--end", "0.3", "--outputs", "trc,c3d"]) == 0
    return out


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


def test_a_result_is_never_written_over(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = {path: path.read_bytes() for path in result.iterdir()}
    assert main(["export", str(result), "--out", str(result)]) == 1
    assert {path: path.read_bytes() for path in result.iterdir()} == before


def test_a_live_session_gives_files_and_an_output_that_fails_is_named(
    live: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "files"
    assert main(["export", str(live), "--out", str(out), "--outputs", "trc,c3d", "--json"]) == 1
    printed = capsys.readouterr()
    figures = json.loads(printed.out)
    assert figures["files"] == ["pose.trc"]
    assert "posefuse solve FILE.mcap" in figures["failed"]["c3d"]
    assert "output c3d: not written" in " ".join(printed.err.split())
    assert (out / "pose.trc").stat().st_size > 0
    with pytest.warns(UserWarning, match="c3d: not written .C3D holds evenly spaced time steps only"):
        pf.read(live).export(tmp_path / "python", ["trc", "c3d"])
    assert (tmp_path / "python" / "pose.trc").read_bytes() == (out / "pose.trc").read_bytes()


def test_an_export_of_which_nothing_can_be_written_leaves_no_folder(
    live: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(live), "--out", str(tmp_path / "files"), "--outputs", "c3d"]) == 1
    assert "evenly spaced" in capsys.readouterr().err
    assert not (tmp_path / "files").exists()
    assert main(["export", str(live), "--out", str(tmp_path / "files"), "--outputs", "trc,nothing"]) == 1
    assert "no plug-in 'nothing'" in capsys.readouterr().err
