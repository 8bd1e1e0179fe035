"""Nothing half-written is left, and what was there before stays until the new is whole."""

from pathlib import Path

import pytest

from posefuse.core import InputError
from posefuse.foundation.output_file import atomic_file


def test_a_file_appears_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "a.tar.gz"
    with atomic_file(path) as temporary:
        temporary.write_text("new")
        assert temporary.suffix == ".gz"
        assert not path.exists()
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("problem", [ValueError, KeyboardInterrupt])
def test_a_file_that_fails_leaves_the_old_one(tmp_path: Path, problem: type[BaseException]) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(problem), atomic_file(path) as temporary:
        temporary.write_text("half")
        raise problem
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_no_other_file_is_touched_and_two_writers_do_not_meet(tmp_path: Path) -> None:
    foreign = tmp_path / "a.partial.txt"
    foreign.write_text("the user's")
    path = tmp_path / "a.txt"
    with atomic_file(path) as one, atomic_file(path) as two:
        assert len({one, two, foreign, path}) == 4
        one.write_text("one")
        two.write_text("two")
    assert path.read_text() == "one"  # the block that ends last
    assert foreign.read_text() == "the user's"
    assert sorted(tmp_path.iterdir()) == sorted([foreign, path])


def test_a_file_has_the_permissions_of_the_users_other_files(tmp_path: Path) -> None:
    (tmp_path / "other").touch()
    with atomic_file(tmp_path / "a") as temporary:
        temporary.write_text("x")
    assert (tmp_path / "a").stat().st_mode == (tmp_path / "other").stat().st_mode


def test_impossible_paths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no folder"), atomic_file(tmp_path / "none" / "a.txt"):
        pass
    with pytest.raises(InputError, match="expected a file name, got a folder"), atomic_file(tmp_path):
        pass
