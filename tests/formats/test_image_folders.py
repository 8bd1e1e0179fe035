"""Depth images as files: every bit comes back, with the noise of the camera; what cannot be is one line."""

import json
from pathlib import Path

import numpy as np
import pytest
from checks import refusal
from videos import ScriptedSource

from posefuse.core import InputError, SourceError
from posefuse.core.depth import DepthImage, DepthNoise
from posefuse.formats.image_folders import ABOUT_FILE, DepthFolder, depth_name
from posefuse.sources import DepthSource
from posefuse_sim.files import write_depth

NOISE = DepthNoise(focal_px=640, baseline_m=0.095)


def image(value: int) -> DepthImage:
    values = np.random.default_rng(value).integers(0, 65535, (12, 16), dtype=np.uint16)
    return DepthImage(values=values, unit_m=0.0005, noise=NOISE)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for i in range(4):
        write_depth(tmp_path, i * 33_333_333, image(i))
    return tmp_path


def test_every_bit_comes_back_with_unit_and_noise(folder: Path) -> None:
    depths = DepthFolder(folder)
    for i in range(4):
        found = depths.at(i * 33_333_333 + 400_000, (16, 12))
        np.testing.assert_array_equal(found.values, image(i).values)
        assert (found.unit_m, found.noise) == (0.0005, NOISE)
    assert depths.at(50_000_000, (16, 12)) is None
    (folder / ABOUT_FILE).unlink()
    plain = DepthFolder(folder).at(0, (16, 12))
    assert (plain.unit_m, plain.noise) == (0.001, DepthNoise())


def test_what_is_no_depth_is_one_line(folder: Path) -> None:
    refusal(InputError, "16x12 px, the colour image has 32x24", lambda: DepthFolder(folder).at(0, (32, 24)))
    (folder / depth_name(0)).write_bytes(b"no image")
    refusal(InputError, "expected a depth image", lambda: DepthFolder(folder).at(0, (16, 12)))
    for wrong in ({"unit_m": 0}, {"unit_m": 0.001, "noise": {"focus": 1}}, {"unit_m": 0.001, "noise": {"focal_px": -1}}, [1]):
        (folder / ABOUT_FILE).write_text(json.dumps(wrong))
        refusal(InputError, r"depth\.json: ", DepthFolder, folder)
    (folder / ABOUT_FILE).unlink()
    (folder / "left.png").write_bytes(b"")
    refusal(InputError, r"named by their time in microseconds, got left\.png", DepthFolder, folder)


def late() -> ScriptedSource:
    """Four frames of 30 Hz whose clock is half a second late and drifts."""
    return ScriptedSource("left", [round(i * 33_333_333 * (1 + 50e-6)) + 500_000_000 for i in range(4)], (16, 12))


def test_frames_get_the_depth_of_their_own_time_in_the_file(folder: Path) -> None:
    (folder / depth_name(2 * 33_333_333)).unlink()
    recorded = late()
    source = DepthSource(recorded, folder, offset_s=0.5, drift_ppm=50)
    frames = list(source.frames())
    assert [frame.depth is not None for frame in frames] == [True, True, False, True]
    np.testing.assert_array_equal(frames[3].depth.values, image(3).values)
    assert (source.camera, source.size_wh, source.stated_frames, len(source.times_ns())) == ("left", (16, 12), 4, 4)
    source.close()
    assert recorded.closed


def test_a_wrong_folder_names_the_camera(tmp_path: Path, folder: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    refusal(SourceError, r"camera left: .*got none", lambda: DepthSource(late(), empty))
    # named by the time of the session, not by that of the video: all images had been left out without a word
    refusal(SourceError, r"camera left: .*no image is within 2 ms of a frame", lambda: DepthSource(late(), folder))
    (folder / depth_name(0)).write_bytes(b"no image")
    with pytest.raises(SourceError, match=r"camera left: .*expected a depth image"):
        list(DepthSource(late(), folder, offset_s=0.5, drift_ppm=50).frames())
