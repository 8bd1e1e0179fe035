"""The date of a recording is what its camera wrote, and nothing else."""

from pathlib import Path

import numpy as np
import pytest
from videos import write_video

from posefuse.sources.video import recorded_at

BLACK = [np.zeros((32, 32, 3), np.uint8)]


@pytest.mark.parametrize(
    ("stated", "when"),
    [
        ("2026-03-01T09:30:00.000000Z", "2026-03-01T09:30:00Z"),
        ("2026-03-01T10:30:00+01:00", "2026-03-01T09:30:00Z"),
        (None, None),
    ],
)
def test_the_stated_time_in_utc(tmp_path: Path, stated: str | None, when: str | None) -> None:
    assert recorded_at(write_video(tmp_path / "a.mp4", BLACK, "mpeg4", stated=stated or "")) == when


def test_a_clock_that_was_never_set_and_a_damaged_file_state_nothing(tmp_path: Path) -> None:
    assert recorded_at(write_video(tmp_path / "a.mp4", BLACK, "mpeg4", stated="1970-01-01T00:00:00.000000Z")) is None
    (tmp_path / "b.mp4").write_bytes(b"not a video")
    assert recorded_at(tmp_path / "b.mp4") is None
