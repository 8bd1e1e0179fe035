"""The date of a recording is what its camera wrote, and nothing else."""

from pathlib import Path

import av
import numpy as np
import pytest

from posefuse.sources.video import recorded_at


def write(path: Path, stated: str | None) -> Path:
    with av.open(str(path), "w") as container:
        if stated is not None:
            container.metadata["creation_time"] = stated
        stream = container.add_stream("mpeg4", rate=10)
        stream.width = stream.height = 32
        stream.pix_fmt = "yuv420p"
        for packet in stream.encode(av.VideoFrame.from_ndarray(np.zeros((32, 32, 3), np.uint8))):
            container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


@pytest.mark.parametrize(
    ("stated", "when"),
    [
        ("2026-03-01T09:30:00.000000Z", "2026-03-01T09:30:00Z"),
        ("2026-03-01T10:30:00+01:00", "2026-03-01T09:30:00Z"),
        (None, None),
    ],
)
def test_the_stated_time_in_utc(tmp_path: Path, stated: str | None, when: str | None) -> None:
    assert recorded_at(write(tmp_path / "a.mp4", stated)) == when


def test_a_clock_that_was_never_set_and_a_damaged_file_state_nothing(tmp_path: Path) -> None:
    assert recorded_at(write(tmp_path / "a.mp4", "1970-01-01T00:00:00.000000Z")) is None
    (tmp_path / "b.mp4").write_bytes(b"not a video")
    assert recorded_at(tmp_path / "b.mp4") is None
