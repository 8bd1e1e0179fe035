"""Absurd work and values that cannot be meant are refused with the number, before anything is done."""

import re
from pathlib import Path

import numpy as np
import pytest

from posefuse.api.track import session_config
from posefuse.cli.command_line import WrongCommandLineError, parse
from posefuse.cli.main import main
from posefuse.core import ConfigError, InputError, SourceError
from posefuse.foundation.settings import settings_from_mapping
from posefuse.pipeline.config import TrackConfig, changes_of, read_config
from posefuse.pipeline.images import common_timeline
from posefuse_sim.render import stage as backend
from posefuse_sim.scene import Scene


def config_of(*words: str) -> TrackConfig:
    found = parse(["track", "here", "--out", "there", *words])
    assert found is not None
    options = found.bound.arguments["options"]
    return session_config(Path("here"), options.config, options.changes)


def test_options_change_the_settings() -> None:
    config = config_of("--start=1", "--person=2,3", "--weights=none", "--raw", "--outputs=trc,c3d", "--set", "end_s=5")
    assert (config.start_s, config.end_s, config.raw, config.outputs) == (1.0, 5.0, True, {"trc": {}, "c3d": {}})
    assert (config.associate.near_xy_m, config.fuse.weights) == ((2.0, 3.0), "none")


@pytest.mark.parametrize("word", ["--start=nan", "--end=inf", "--person=nan,0", "--start=1e300", "--person=1e300,0"])
def test_invalid_options_are_refused_by_name(word: str) -> None:
    with pytest.raises(WrongCommandLineError, match=rf"{word.partition('=')[0]}: expected [SXY,]+ \(input should be") as caught:
        config_of(word)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "setting",
    ["rate_hz=1e9", "rate_hz=nan", "cameras.a.offset_s=1e12", "cameras.a.offset_s=nan", "associate.max_people=-1", "end_s=inf"],
)
def test_impossible_settings_are_refused(setting: str) -> None:
    with pytest.raises(ConfigError, match=setting.partition("=")[0].rpartition(".")[2]):
        read_config(None, changes_of([setting]))


def test_the_number_of_time_steps_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    times_ns = {"a": np.arange(100) * 33_333_333, "b": np.arange(100) * 33_333_333}
    assert common_timeline(times_ns, 1000.0, None, None).count > 3000
    late = times_ns | {"b": times_ns["b"] + 3 * 10**18}
    with pytest.raises(SourceError, match=r"9e\+10 time steps"):
        common_timeline(late, None, None, None)
    monkeypatch.setattr("posefuse.pipeline.images._MOST_TIME_STEPS", 1000)
    with pytest.raises(SourceError, match=r"3301 time steps \(3\.301 s at 1000 Hz\); expected at most 1000: check rate_hz"):
        common_timeline(times_ns, 1000.0, None, None)


SCENE = {"duration_s": 1.0, "cameras": {"kind": "ring", "count": 2}}


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"count": 1_000_000}, "less than or equal to 1000, got 1000000"),
        ({"image": {"size_px": [20_000, 20_000]}}, "less than or equal to 16384, got 20000"),
        ({"sensor": {"rate_hz": 1e9}}, "less than or equal to 1000, got 1000000000"),
    ],
)
def test_impossible_scenes_are_refused(changes: dict, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        settings_from_mapping(SCENE | {"cameras": SCENE["cameras"] | changes}, Scene, "scene.yaml")


def test_an_image_larger_than_the_framebuffer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "_largest_side_px", lambda _: 4096)
    backend.check_framebuffer("egl", 4096)
    with pytest.raises(InputError, match=r"side of 5000 px .* expected at most 4096 px"):
        backend.check_framebuffer("egl", 5000)


@pytest.mark.parametrize(
    "words",
    [
        "calibrate print --target markers --marker-mm nan --ids 1 --out a.pdf",
        "calibrate clocks here --seconds inf",
        "calibrate verify a=b --rig rig.toml --target b.toml --every 0",
        "simulate scene.yaml --out there --workers -1",
        "compare a.trc b.trc --align-first nan",
    ],
)
def test_options_of_other_commands_are_refused(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(words.split())
    said = capsys.readouterr().err
    assert code == 1 and re.search("expected (a|N|MM) ", said) and said.count("\n") == 1


def test_openpose_files_numbered_by_date_are_refused(
    demo_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "session"
    session.mkdir()
    (session / "rig.toml").write_bytes((demo_session / "rig.toml").read_bytes())
    people = '{"people": [{"pose_keypoints_2d": [' + ", ".join(["1, 2, 0.5"] * 17) + "]}]}"
    for camera, number in (("cam00", 1), ("cam01", 20261122153000)):
        folder = session / "pose2d" / camera
        folder.mkdir(parents=True)
        (folder / f"{number}_keypoints.json").write_text(people)
    (session / "rig.toml").write_bytes((demo_session / "rig.toml").read_bytes())
    assert main(["track", str(session), "--out", str(tmp_path / "out"), "--rate", "30"]) == 1
    assert "frame numbers 1 to 20261122153000: 2.026e+13 time steps" in capsys.readouterr().err


def test_a_truncated_camera_is_named_by_track(demo_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session = tmp_path / "session"
    session.mkdir()
    (session / "rig.toml").write_bytes((demo_session / "rig.toml").read_bytes())
    folder = session / "pose2d"
    people = '{"people": [{"pose_keypoints_2d": [' + ", ".join(["300, 200, 0.5"] * 17) + "]}]}"
    for camera, frames in (("cam00", 40), ("cam01", 20)):
        (folder / camera).mkdir(parents=True)
        for i in range(frames):
            (folder / camera / f"{i:04d}.json").write_text(people)
    (session / "rig.toml").write_bytes((demo_session / "rig.toml").read_bytes())
    main(["track", str(session), "--out", str(tmp_path / "out"), "--outputs", "", "--rate", "30"])
    assert "warning: camera cam01: it stops at 0.63 s, the recording at 1.30 s" in capsys.readouterr().err
