"""Videos: every frame keeps its time, and parts join without a seam."""

from pathlib import Path

import numpy as np
import pytest
from checks import refusal

from posefuse.core import InputError
from posefuse.formats.video import VideoWriter, join_videos, read_video


def _image(i: int, size_wh=(96, 64)) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(size_wh[0]), np.arange(size_wh[1]))
    return np.stack([columns * 2, rows * 3, np.full_like(rows, (20 + 23 * i) % 256)], axis=-1).astype(np.uint8)


def _write(path: Path, t_ns, first: int = 0, size_wh=(96, 64), crf: int = 8) -> None:
    with VideoWriter(path, size_wh, 30.0, crf) as writer:
        for i, t in enumerate(t_ns):
            writer.write(_image(first + i, size_wh), int(t))


def test_uneven_times_and_a_late_start_come_back_to_the_microsecond(tmp_path: Path):
    t_ns = np.array([1_300_207_319, 1_333_000_000, 1_333_001_000, 1_900_000_499, 60_000_000_000])
    _write(tmp_path / "a.mp4", t_ns)
    read = list(read_video(tmp_path / "a.mp4"))
    np.testing.assert_allclose([t for t, _ in read], t_ns, atol=501)
    for i, (_, image) in enumerate(read):
        assert np.abs(image.astype(int) - _image(i)).mean() < 6


@pytest.mark.parametrize("size_wh", [(96, 64), (97, 64), (96, 63), (33, 35)])
def test_any_size_keeps_its_size(tmp_path: Path, size_wh):
    _write(tmp_path / "a.mp4", [0, 33_000_000], size_wh=size_wh)
    assert [image.shape for _, image in read_video(tmp_path / "a.mp4")] == [(size_wh[1], size_wh[0], 3)] * 2


def test_joined_parts_are_all_frames_at_their_times(tmp_path: Path):
    t_ns = 700_207_000 + np.arange(9) * 33_333_000
    _write(tmp_path / "0.mp4", t_ns[:4])
    _write(tmp_path / "1.mp4", t_ns[4:5], first=4)
    _write(tmp_path / "2.mp4", t_ns[5:], first=5)
    join_videos([tmp_path / f"{i}.mp4" for i in range(3)], tmp_path / "all.mp4")
    read = list(read_video(tmp_path / "all.mp4"))
    np.testing.assert_allclose([t for t, _ in read], t_ns, atol=501)
    for i, (_, image) in enumerate(read):
        assert np.abs(image.astype(int) - _image(i)).mean() < 6


def test_same_frames_same_bytes(tmp_path: Path):
    for name in ("a.mp4", "b.mp4"):
        _write(tmp_path / name, np.arange(70) * 33_000_000)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_wrong_frames_and_times_are_refused(tmp_path: Path):
    with VideoWriter(tmp_path / "a.mp4", (96, 64), 30.0) as writer:
        with pytest.raises(InputError, match=r"expected RGB uint8 frames of \(96, 64\) px, got uint8 \(10, 10, 3\)"):
            writer.write(np.zeros((10, 10, 3), np.uint8), 0)
        writer.write(_image(0), 5_000_000)
        refusal(InputError, "each later than 5000 us, got 5000 us", lambda: writer.write(_image(1), 5_000_400))


def test_files_that_cannot_be_are_named(tmp_path: Path):
    refusal(InputError, "nowhere", VideoWriter, tmp_path / "nowhere" / "a.mp4", (96, 64), 30.0)
    refusal(InputError, r"absent\.mp4: cannot be read as a video", lambda: next(read_video(tmp_path / "absent.mp4")))
    (tmp_path / "text.mp4").write_text("no video")
    refusal(InputError, "cannot be joined", join_videos, [tmp_path / "text.mp4"], tmp_path / "all.mp4")
