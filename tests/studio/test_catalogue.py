"""What a list of recordings shows, and that looking changes nothing among them."""

import math
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_session import saved_session

import posefuse as pf
from posefuse.core import Rig
from posefuse.foundation.output_folder import MARK_FILE
from posefuse_studio.catalogue import find_recordings, listed, thumbnail

Saved = tuple[Path, Path]


@pytest.fixture
def saved_walk(tmp_path: Path, ring_rig: Callable[..., Rig]) -> Saved:
    """(session, result)."""
    return saved_session(tmp_path, ring_rig)


def files_below(folder: Path) -> dict[str, float]:
    return {path.as_posix(): path.stat().st_mtime_ns for path in folder.rglob("*")}


def test_a_recording_at_a_glance(saved_walk: Saved) -> None:
    _, result = saved_walk
    one = listed(result)
    assert (one.session, one.people, one.cameras, one.recorded) == ("walk", ("Ada",), 3, "2026-03-01T09:30:00Z")
    assert one.duration_s == pytest.approx(29 / 30, rel=1e-6)
    assert one.coverage == pytest.approx(1 - 10 / (30 * 17))
    assert (one.sigma_mm, one.reprojection_px) == (pytest.approx(20.0), 2.5)
    assert not (one.live or one.edited or one.problem)


def test_the_second_look_reads_nothing(saved_walk: Saved, monkeypatch: pytest.MonkeyPatch) -> None:
    _, result = saved_walk
    before = files_below(result)
    one, picture = listed(result), thumbnail(result)
    monkeypatch.setattr(pf, "read", lambda *_, **__: pytest.fail("read again"))
    assert listed(result) == one
    assert thumbnail(result) == picture
    assert files_below(result) == before  # nothing is kept among the recordings


def test_one_that_was_changed_is_looked_at_again(saved_walk: Saved) -> None:
    _, result = saved_walk
    listed(result)
    pf.read(result).save(result, replace=True)
    about = result / "recording.json"
    about.write_text(about.read_text().replace("Ada", "Bob"))
    os.utime(about, ns=(1, 1))
    assert listed(result).people == ("Bob",)


def test_the_picture_is_small_and_shows_a_view(saved_walk: Saved) -> None:
    _, result = saved_walk
    picture = cv2.imdecode(np.frombuffer(thumbnail(result), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape[1] <= 320
    assert picture.std() > 1


def test_without_its_videos_it_is_drawn_on_plain_ground(saved_walk: Saved) -> None:
    session, result = saved_walk
    shutil.rmtree(session)
    assert len(thumbnail(result)) > 1000


def test_all_below_a_folder_the_newest_first(saved_walk: Saved, tmp_path: Path) -> None:
    _, result = saved_walk
    study = tmp_path / "study"
    for place, seconds in (("P01/walk1", 100), ("P02/run", 300), (".hidden/walk", 400), ("P01/walk2", 200)):
        shutil.copytree(result, study / place)
        os.utime(study / place / MARK_FILE, (seconds, seconds))
    (study / "P02" / "recording.json.txt").write_text("no result")
    (study / "link").symlink_to(result, target_is_directory=True)
    found = find_recordings(study)
    assert [path.relative_to(study).as_posix() for path in found] == ["P02/run", "P01/walk2", "P01/walk1"]
    assert len(find_recordings(study, most=2)) == 2
    assert [path.name for path in found if listed(path).matches("p01 ADA")] == ["walk2", "walk1"]
    assert not any(listed(path).matches("nobody else") for path in found)


def test_later_parts_of_a_live_session_and_its_robot_are_not_recordings_of_their_own(tmp_path: Path) -> None:
    for name in ("a.mcap", "a.2.mcap", "b.2.mcap", "a.robot.mcap"):
        (tmp_path / name).write_bytes(b"")
    assert {path.name for path in find_recordings(tmp_path)} == {"a.mcap", "b.2.mcap"}


def test_one_that_cannot_be_read_has_a_reason(saved_walk: Saved, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra `ros` is not installed")
    _, result = saved_walk
    (result / "recording.npz").write_bytes(b"damaged")
    one = listed(result)
    assert "recording.npz" in one.problem
    assert math.isnan(one.sigma_mm)
    (tmp_path / "a.mcap").write_bytes(b"no recording")
    assert "a.mcap" in listed(tmp_path / "a.mcap").problem
