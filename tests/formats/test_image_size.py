"""A video whose size is not the calibrated one: what is distinguished, what must be stated."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from checks import refusal

from posefuse.core import CalibrationError, Camera, Rig
from posefuse.formats.rig import fit_camera_to_video, read_rig
from posefuse.formats.rig.image_size import black_bars
from posefuse.sources import VideoConfig

POINT = np.array([0.2, -0.3, 1.1])


@pytest.fixture
def camera(ring_rig: Callable[..., Rig]) -> Camera:
    return ring_rig(1, size_wh=(1088, 1920), distortion=(0.1, -0.05, 0.001, 0.002)).cameras[0]


def letterboxed(size_wh: tuple[int, int], bars: tuple[int, int, int, int]) -> np.ndarray:
    left, top, right, bottom = bars
    image = np.full((size_wh[1], size_wh[0], 3), 3, np.uint8)
    inside = image[top : size_wh[1] - bottom, left : size_wh[0] - right]
    inside[:] = np.random.default_rng(0).integers(60, 200, inside.shape)
    return image


@pytest.mark.parametrize(
    ("size_wh", "how", "factor", "shift_px"),
    [
        ((1088, 1920), {}, (1, 1), (0, 0)),
        *((size_wh, {}, (size_wh[0] / 1088, size_wh[1] / 1920), (0, 0)) for size_wh in ((544, 960), (2176, 3840), (725, 1280))),
        ((1080, 1920), {"crop": (8, 0)}, (1, 1), (-8, 0)),
        ((1080, 1920), {"scale": True}, (1080 / 1088, 1), (0, 0)),
        ((1080, 1920), {"bars": (0, 7, 0, 7)}, (1080 / 1088,) * 2, (0, 960 * 8 / 1088)),
        ((1920, 960), {"bars": (688, 0, 688, 0)}, (0.5, 0.5), (688, 0)),
        ((544, 1000), {"bars": (0, 0, 0, 40)}, (0.5, 0.5), (0, 0)),
    ],
)
def test_what_was_done_to_an_image_is_stated_or_shown_by_its_proportions_or_bars(
    camera: Camera, size_wh: tuple[int, int], how: dict, factor: tuple[float, float], shift_px: tuple[float, float]
) -> None:
    """Resampled about the corner of the image, then moved."""
    how = {"image": letterboxed(size_wh, how["bars"])} if "bars" in how else how
    got = fit_camera_to_video(camera, size_wh, **how)
    np.testing.assert_allclose(got.project(POINT), (camera.project(POINT) + 0.5) * factor - 0.5 + shift_px)
    assert got.size_wh == size_wh


@pytest.mark.parametrize("bars", [(0, 0, 0, 0), (0, 30, 0, 30), (20, 0, 20, 0)])
def test_what_the_image_does_not_show_must_be_stated(camera: Camera, bars: tuple[int, int, int, int]) -> None:
    with pytest.raises(CalibrationError, match=r"1080x1920 px, calibrated at 1088x1920 px.*crop = \[left, top\].*scale = true"):
        fit_camera_to_video(camera, (1080, 1920), image=letterboxed((1080, 1920), bars))


def test_wrong_statements(camera: Camera) -> None:
    fit = partial(fit_camera_to_video, camera)
    refusal(CalibrationError, "expected left from 0 to 8 and top from 0 to 0", fit, (1080, 1920), crop=(9, 0))
    refusal(CalibrationError, "left from 0 to -12", fit, (1100, 1920), crop=(0, 0))
    refusal(CalibrationError, "expected crop or scale, got both", fit, (1080, 1920), crop=(0, 0), scale=True)
    refusal(CalibrationError, "turned by 90 degrees", fit, (1920, 1088))


def test_bars_are_measured_through_blur() -> None:
    image = letterboxed((200, 120), (0, 9, 0, 11)).astype(float)
    blurred = np.stack([np.convolve(column, [0.2, 0.6, 0.2], "same") for column in image[..., 1].T]).T
    assert black_bars(np.repeat(blurred[..., None], 3, axis=2).astype(np.uint8)) == (0, 9, 0, 11)
    assert black_bars(np.zeros((40, 30, 3), np.uint8)) == (0, 0, 0, 0)


def test_the_real_videos_are_letterboxed_not_cropped(shared_data: Path) -> None:
    """cam01 and cam02 are 1080 px wide for a calibration of 1088: black bars above and below say how they were made."""
    folder = shared_data / "pose2sim_single"
    rig = read_rig(folder / "calibration" / "Calib_qualisys.toml")
    for name, camera in zip(("cam01", "cam02"), rig, strict=False):
        image = next(VideoConfig(folder / "videos" / f"{name}.mp4", name).build().frames()).image
        assert black_bars(image) == (0, 7, 0, 7)
        fitted = fit_camera_to_video(camera, (1080, 1920), image=image)
        assert fitted.K[0, 0] / camera.K[0, 0] == pytest.approx(1080 / 1088)
