"""Absurd work and values that cannot be meant are refused with the number, before anything is done."""

from pathlib import Path

import numpy as np
import pytest
from checks import refusal
from studies import write_openpose

from posefuse.cli.main import main
from posefuse.core import InputError, SourceError
from posefuse.pipeline.time_steps import common_timeline
from posefuse_sim.render import stage as backend


def test_the_number_of_time_steps_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    times_ns = {"a": np.arange(100) * 33_333_333, "b": np.arange(100) * 33_333_333}
    assert common_timeline(times_ns, 1000.0, None, None).count > 3000
    late = times_ns | {"b": times_ns["b"] + 3 * 10**18}
    refusal(SourceError, r"9e\+10 time steps", common_timeline, late, None, None, None)
    monkeypatch.setattr("posefuse.pipeline.time_steps._MOST_TIME_STEPS", 1000)
    with pytest.raises(SourceError, match=r"3301 time steps \(3\.301 s at 1000 Hz\); expected at most 1000: check rate_hz"):
        common_timeline(times_ns, 1000.0, None, None)


def test_an_image_larger_than_the_framebuffer_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(backend, "_largest_side_px", lambda _: 4096)
    backend.check_framebuffer("egl", 4096)
    refusal(InputError, r"side of 5000 px .* expected at most 4096 px", backend.check_framebuffer, "egl", 5000)


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        ({"cam00": [1], "cam01": [20261122153000]}, "frame numbers 1 to 20261122153000: 2.026e+13 time steps"),
        ({"cam00": range(40), "cam01": range(20)}, "warning: camera cam01: it stops at 0.63 s, the recording at 1.30 s"),
    ],
    ids=["numbered by date", "truncated"],
)
def test_what_the_numbers_of_openpose_files_show_is_named(
    frames: dict, words: str, demo_session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for camera, numbers in frames.items():
        write_openpose(tmp_path / "session" / "pose2d" / camera, dict.fromkeys(numbers, np.full((1, 17, 2), [300.0, 200.0])))
    (tmp_path / "session" / "rig.toml").write_bytes((demo_session / "rig.toml").read_bytes())
    main(["track", str(tmp_path / "session"), "--out", str(tmp_path / "out"), "--outputs", "", "--rate", "30"])
    assert words in capsys.readouterr().err
