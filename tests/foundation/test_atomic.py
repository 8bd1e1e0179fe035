"""Nothing half-written is left, and what was there before stays until the new is whole."""

from pathlib import Path

import pytest

from posefuse.core import InputError
from posefuse.foundation.atomic import atomic_file, atomic_folder


def test_a_file_appears_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "a.tar.gz"
    with atomic_file(path) as beside:
        beside.write_text("new")
        assert beside.suffix == ".gz"
        assert not path.exists()
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("problem", [ValueError, KeyboardInterrupt])
def test_a_file_that_fails_leaves_the_old_one(tmp_path: Path, problem: type[BaseException]) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(problem), atomic_file(path) as beside:
        beside.write_text("half")
        raise problem
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_appears_at_the_end_and_replaces_its_like(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "result"
    for text in ("one", "two"):
        with atomic_folder(path) as beside:
            assert list(beside.iterdir()) == []
            (beside / "recording.json").write_text(text)
            (beside / text).write_text(text)
    assert (path / "recording.json").read_text() == "two"
    assert not (path / "one").exists()
    assert [entry.name for entry in path.parent.iterdir()] == ["result"]


@pytest.mark.parametrize("problem", [ValueError, KeyboardInterrupt])
def test_a_folder_that_fails_leaves_the_old_one(tmp_path: Path, problem: type[BaseException]) -> None:
    path = tmp_path / "result"
    path.mkdir()
    (path / "recording.json").write_text("old")
    with pytest.raises(problem), atomic_folder(path) as beside:
        (beside / "recording.json").write_text("half")
        raise problem
    assert (path / "recording.json").read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_of_something_else_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "home"
    path.mkdir()
    (path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"home: holds other files \(thesis\.tex\)"), atomic_folder(path) as beside:
        (beside / "recording.json").write_text("new")
    assert (path / "thesis.tex").read_text() == "years of work"
    assert list(tmp_path.iterdir()) == [path]


def test_a_killed_run_does_not_block_the_next(tmp_path: Path) -> None:
    (tmp_path / "result.partial").mkdir()
    (tmp_path / "result.partial" / "half").write_text("half")
    with atomic_folder(tmp_path / "result") as beside:
        (beside / "whole").write_text("whole")
    assert [entry.name for entry in (tmp_path / "result").iterdir()] == ["whole"]


def test_places_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="expected a folder to write results to, got a file"), atomic_folder(tmp_path / "file"):
        pass
    with pytest.raises(InputError, match="no folder can be made there"), atomic_folder(tmp_path / "file" / "result"):
        pass
    with pytest.raises(InputError, match="there is no folder"), atomic_file(tmp_path / "none" / "a.txt"):
        pass
    with pytest.raises(InputError, match="expected a file name, got a folder"), atomic_file(tmp_path):
        pass
