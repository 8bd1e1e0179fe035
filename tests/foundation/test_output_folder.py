"""Results appear whole or not at all; a folder of posefuse is moved aside whole, any other is refused, and none is removed."""

import errno
import os
import re
import shutil
from collections import namedtuple
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from checks import refusal

from posefuse.core import DiskFullError, InputError
from posefuse.foundation.output_file import atomic_file, check_space, earlier_kept, write_text
from posefuse.foundation.output_folder import MARK_FILE, FolderMark, find_unfinished, growing_folder, output_folder, read_mark


def make(path: Path, text: str = "one", **options: Any) -> None:
    options = {"command": "track", "replace": True, **options}
    with output_folder(path, **options) as out:
        (out.folder / "recording.json").write_text(text)
        (out.folder / "deep").mkdir()
        (out.folder / "deep" / text).write_text(text)


def make_warned(path: Path, text: str) -> list[str]:
    """`make` with what it warns of."""
    with pytest.warns(UserWarning) as caught:
        make(path, text)
    return [str(one.message) for one in caught]


def tree(folder: Path) -> dict[str, bytes | None]:
    """Every entry below `folder` with its bytes, None for folders and links."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() and not path.is_symlink() else None
        for path in folder.rglob("*")
    }


def refused(path: Path, reason: str, **options: Any) -> None:
    """`path` is refused before the block, in one line, and nothing at all changes in the folder it lies in."""
    before = tree(path.parent) if path.parent.is_dir() else {}
    refusal(InputError, reason, make, path, "new", **options)
    assert (tree(path.parent) if path.parent.is_dir() else {}) == before


def test_a_folder_appears_when_it_is_complete_and_moves_a_result_of_the_same_command_aside(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "result"
    for text in ("one", "two"):
        with output_folder(path, command="track", replace=True) as out:
            assert [entry.name for entry in out.folder.iterdir()] == [MARK_FILE]
            assert out.folder.parent == path.parent and out.target == path
            (out.folder / "recording.json").write_text(text)
            (out.folder / text).write_text(text)
            assert out.final(out.folder / text) == path / text
            assert not (path / text).exists()
    assert tree(path).keys() == {MARK_FILE, "recording.json", "two"}
    [aside] = set(path.parent.iterdir()) - {path}
    assert aside.name.startswith("result.replaced-") and tree(aside).keys() == {MARK_FILE, "recording.json", "one"}


def test_the_mark_states_the_command_and_differs_between_no_two_folders(tmp_path: Path) -> None:
    for name in ("result", "another"):
        make(tmp_path / name)
    assert read_mark(tmp_path / "result") == FolderMark(command="track")
    assert tree(tmp_path / "result") == tree(tmp_path / "another")  # the same work gives the same bytes


@pytest.mark.parametrize("problem", [ValueError, KeyboardInterrupt])
def test_what_fails_keeps_the_old_result_and_the_old_file(tmp_path: Path, problem: type[BaseException]) -> None:
    path = tmp_path / "result"
    make(path)
    (tmp_path / "a.txt").write_text("old")
    before = tree(tmp_path)
    with pytest.raises(problem), output_folder(path, command="track", replace=True) as out:
        (out.folder / "recording.json").write_text("half")
        raise problem
    with pytest.raises(problem), output_folder(tmp_path / "new" / "deep", command="track"):
        raise problem
    with pytest.raises(problem), atomic_file(tmp_path / "a.txt") as temporary:
        temporary.write_text("half")
        raise problem
    assert tree(tmp_path) == before


@pytest.mark.parametrize("number", [errno.EIO, errno.EROFS, errno.ESTALE, errno.ENAMETOOLONG])
def test_whatever_keeps_a_file_from_being_written_is_one_line(tmp_path: Path, number: int) -> None:
    """A network disk that went away ended in a trace."""
    (tmp_path / "a.txt").write_text("old")

    def written() -> None:
        with atomic_file(tmp_path / "a.txt"):
            raise OSError(number, os.strerror(number))

    refusal(InputError, rf"a\.txt: cannot be written \({os.strerror(number)}\)", written)
    assert tree(tmp_path) == {"a.txt": b"old"}


def test_trouble_with_another_file_is_not_blamed_on_the_one_that_is_written(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="none"), atomic_file(tmp_path / "a.txt"):
        (tmp_path / "none").read_text()
    assert not list(tmp_path.iterdir())


def test_a_result_is_replaced_only_on_request_and_by_the_same_command(tmp_path: Path) -> None:
    make(tmp_path / "result")
    refused(tmp_path / "result", "holds results already; .*`replace=True`.* kept in NAME.replaced-TIME", replace=False)
    refused(tmp_path / "result", "holds results of `posefuse track`", command="simulate")
    make(tmp_path / "result", "two")


def test_all_that_is_in_a_result_stays_in_it_when_it_is_moved_aside(tmp_path: Path) -> None:
    path = tmp_path / "result"
    make(path)
    (path / "thesis.docx").write_text("years of work")
    (path / "recording.json").write_text("changed")
    (path / "empty").mkdir()
    (path / "deep" / "one").rename(tmp_path / "elsewhere")
    (path / "deep" / "one").symlink_to(tmp_path / "elsewhere")
    make(path / "of another day")
    before = tree(path)
    said = make_warned(path, "two")
    [aside] = tmp_path.glob("result.replaced-*")
    assert tree(aside) == before and tree(path).keys() == {MARK_FILE, "recording.json", "deep", "deep/two"}
    assert said == [f"the earlier results are kept in {aside}"]


@pytest.mark.parametrize("mark", [None, "[" * 100_000, '{"files": ["thesis.docx"]}', "[]", "{"])
def test_a_folder_without_our_mark_is_refused_by_name_with_and_without_force(tmp_path: Path, mark: str | None) -> None:
    make(tmp_path / "result")
    (tmp_path / "result" / MARK_FILE).unlink()
    if mark is not None:
        (tmp_path / "result" / MARK_FILE).write_text(mark)
    for replace in (True, False):
        refused(tmp_path / "result", r"holds what posefuse did not write \(deep, .+\)", replace=replace)


def test_a_foreign_folder_is_refused_and_an_empty_folder_is_used(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    make(tmp_path / "home", replace=False)
    shutil.rmtree(tmp_path / "home")
    (tmp_path / "home").mkdir()
    for name in ("a", "b", "c", "d", "recording.json"):
        (tmp_path / "home" / name).write_text("the user's")
    refused(tmp_path / "home", r"\(a, b, c, \.\.\.\)")


@pytest.mark.parametrize("name", [".DS_Store", "Thumbs.db", "desktop.ini"])
def test_a_folder_that_finder_or_explorer_has_shown_is_as_good_as_empty(tmp_path: Path, name: str) -> None:
    (tmp_path / "result").mkdir()
    (tmp_path / "result" / name).write_text("icons")
    make(tmp_path / "result", replace=False)
    [aside] = tmp_path.glob("result.replaced-*")
    assert tree(aside) == {name: b"icons"}
    # any other hidden file is the user's
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / ".notes").write_text("the user's")
    refused(tmp_path / "other", r"\(\.notes\)")


def test_an_output_inside_around_or_equal_to_an_input_is_refused(tmp_path: Path) -> None:
    session = tmp_path / "session"
    (session / "videos").mkdir(parents=True)
    (session / "videos" / "cam.mp4").write_text("video")
    (tmp_path / "link").symlink_to(session, target_is_directory=True)
    for inputs in ([session], [tmp_path / "link"]):
        for name in ("session", "link"):
            refused(tmp_path / name, "is the input .* itself", inputs=inputs)
            refused(tmp_path / name / "result", "lies inside the input", inputs=inputs)
            refused(tmp_path / name / "new" / "result", "lies inside the input", inputs=inputs)
        refused(tmp_path, "contains the input", inputs=inputs)
    refused(session / "videos" / ".." / "videos", "contains the input", inputs=[session / "videos" / "cam.mp4"])
    refused(session / "videos" / "cam.mp4", "is the input", inputs=[session / "videos" / "cam.mp4"])
    make(tmp_path / "result", inputs=[session, tmp_path / "not there"])


def test_upper_and_lower_case_are_equal_on_a_case_insensitive_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "session").mkdir()
    real_stat = os.stat
    monkeypatch.setattr(os, "stat", lambda path, **options: real_stat(str(path).replace("SESSION", "session"), **options))
    refusal(InputError, "lies inside the input", make, tmp_path / "SESSION" / "result", inputs=[tmp_path / "session"])
    refusal(InputError, "is the input", make, tmp_path / "SESSION", inputs=[tmp_path / "session"])


def test_impossible_output_paths_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("x")
    refused(tmp_path / "file", "expected a folder to write results to, got a file")
    refused(tmp_path / "file" / "result", "no folder can be made there|cannot be looked at")
    refused(tmp_path / ("x" * 300), "File name too long")
    refusal(InputError, "top of a disk", make, Path(tmp_path.anchor))
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    refused(tmp_path / "circle", "cannot be followed|no folder can be made there|cannot be looked at")
    make(tmp_path / "here")
    monkeypatch.chdir(tmp_path / "here" / "deep")
    for place in (Path(), Path(), Path(".."), tmp_path / "here"):
        refused(place, "is the folder posefuse was started in, or contains it")
    make(Path("..") / ".." / "other")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="needs a user without write permission everywhere")
def test_a_parent_folder_without_write_permission_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir(mode=0o500)
    refused(tmp_path / "mine" / "result", "no folder can be made there")


def test_a_full_disk_is_reported_before_the_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10**9, 10**9 - 5_000_000, 5_000_000))
    refused(tmp_path / "new" / "result", "about 7 MB will be written, 5 MB are free", estimated_bytes=7_000_000)
    make(tmp_path / "result", estimated_bytes=4_000_000)


@pytest.mark.parametrize(("needed", "free"), [(1, 0), (400_000, 300_000), (1_200_000, 1_100_000), (2_000_000, 1_999_999)])
def test_a_full_disk_has_less_free_than_will_be_written_in_words_too(tmp_path, monkeypatch, needed: int, free: int) -> None:
    """Both were rounded to the nearest: "about 0 MB will be written, 0 MB are free"."""
    monkeypatch.setattr(shutil, "disk_usage", lambda _: namedtuple("usage", "free")(free))
    text = refusal(InputError, "MB will be written", check_space, tmp_path, needed)
    stated_needed, stated_free = (int(number) for number in re.findall(r"(\d+) MB", text))
    assert stated_free * 1e6 <= free < needed <= stated_needed * 1e6 and stated_free < stated_needed


def test_a_symbolic_link_to_a_folder_is_followed(tmp_path: Path) -> None:
    make(tmp_path / "result")
    (tmp_path / "link").symlink_to(tmp_path / "result", target_is_directory=True)
    make(tmp_path / "link", "two")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "result" / "deep" / "two").is_file()


def test_an_interrupted_run_is_found_and_continued(tmp_path: Path) -> None:
    path = tmp_path / "result"
    with pytest.raises(KeyboardInterrupt), output_folder(path, command="track", keep_unfinished=True) as out:
        (out.folder / "half").write_text("half")
        raise KeyboardInterrupt
    with pytest.raises(KeyboardInterrupt), output_folder(path, command="track", keep_unfinished=True):
        raise KeyboardInterrupt  # before anything was written: nothing to keep
    (tmp_path / ".result.1.unfinished").mkdir()
    make(tmp_path / "another")
    assert find_unfinished(path) == [out.folder]
    assert find_unfinished(tmp_path / "another") == find_unfinished(tmp_path / "no" / "such") == []
    with output_folder(path, command="track", unfinished=out.folder) as again:
        assert (again.folder / "half").read_text() == "half"
        (again.folder / "whole").write_text("whole")
    assert sorted(entry.name for entry in path.iterdir()) == ["half", MARK_FILE, "whole"]
    assert read_mark(path) == FolderMark(command="track") and find_unfinished(path) == []


def test_files_that_appear_during_the_run_are_not_replaced_and_the_new_results_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "result"
    said = r"the results are complete in .* but cannot be moved there"
    with pytest.raises(InputError, match=said), output_folder(path, command="track", replace=True) as out:
        (out.folder / "recording.json").write_text("new")
        path.mkdir()
        (path / "thesis.docx").write_text("years of work")
    assert (path / "thesis.docx").read_text() == "years of work"
    assert (out.folder / "recording.json").read_text() == "new"
    assert read_mark(out.folder) == FolderMark(command="track")


def rename_as(monkeypatch: pytest.MonkeyPatch, before: Callable[[Path], None]) -> None:
    """Something happens before each rename."""
    rename = Path.rename
    monkeypatch.setattr(Path, "rename", lambda self, target: (before(self), rename(self, target))[1])


def test_a_file_added_during_a_replacement_is_kept_and_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "result"
    make(path)
    rename_as(monkeypatch, lambda moved: (path / "late.txt").write_text("the user's") if moved == path else None)
    said = make_warned(path, "two")
    (aside,) = tmp_path.glob("result.replaced-*")
    assert (aside / "late.txt").read_text() == "the user's"
    assert len(said) == 1 and str(aside) in said[0]
    assert (path / "recording.json").read_text() == "two"


def test_the_old_result_comes_back_when_the_new_cannot_be_moved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "result"
    make(path)
    before = tree(path)

    def no_space(moved: Path) -> None:
        if moved.suffix == ".unfinished":
            raise OSError(28, "No space left on device")

    rename_as(monkeypatch, no_space)
    refusal(InputError, r"complete in .* but cannot be moved there \(No space left", make, path, "two")
    assert tree(path) == before


def test_folders_and_files_have_the_permissions_of_the_users_others(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").touch()
    make(tmp_path / "result")
    with atomic_file(tmp_path / "a") as temporary:
        temporary.write_text("x")
    for made, others in (("result", "other"), ("a", "other/file")):
        assert (tmp_path / made).stat().st_mode == (tmp_path / others).stat().st_mode


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_disk_that_fills_keeps_what_was_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    make(tmp_path / "result")
    with pytest.raises(DiskFullError) as caught, output_folder(tmp_path / "result", command="track", replace=True) as out:
        (out.folder / "first").write_text("hours of work")
        fill_disk(monkeypatch, number)
        write_text(out.folder / "second", "no room")
    monkeypatch.undo()
    [left] = tmp_path.glob(".result.*.unfinished")
    assert str(caught.value).endswith(f"({os.strerror(number)})); what was finished until then is kept in {left}")
    assert sorted(entry.name for entry in left.iterdir()) == ["first", MARK_FILE]
    assert (tmp_path / "result" / "recording.json").read_text() == "one"
    # the next run reports it
    said = make_warned(tmp_path / "result", "two")
    [aside] = tmp_path.glob("result.replaced-*")
    assert said[0].startswith(f"{left}: was left") and said[1:] == [f"the earlier results are kept in {aside}"]


def test_a_disk_that_is_full_from_the_beginning_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DiskFullError, match="nothing was written"), output_folder(tmp_path / "result", command="track"):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert not list(tmp_path.iterdir())


def test_a_full_disk_leaves_no_half_mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fill_disk(monkeypatch, errno.ENOSPC)
    said = r"study: cannot be written \(No space left on device\)"
    refusal(InputError, said, growing_folder, tmp_path / "study", command="batch", names=["a.json"])
    refused(tmp_path / "result", r"no folder can be made there \(No space left on device\)")


def test_a_folder_that_grows_is_opened_again_and_no_foreign_one_is_taken_for_it(tmp_path: Path) -> None:
    names = ["a.json", "b.json"]
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "videos.zip").write_text("the user's")
    for _ in range(2):
        assert growing_folder(tmp_path / "study", command="batch", names=names) == tmp_path / "study"
    said = "holds results of `posefuse batch`"
    refusal(InputError, said, growing_folder, tmp_path / "study", command="experiment", names=names)
    for name in (*names, MARK_FILE):
        other = tmp_path / f"with {name}"
        other.mkdir()
        (other / name).write_text("the user's")
        said = f"holds {name}, which posefuse did not write"
        refusal(InputError, said, growing_folder, other, command="batch", names=names)


def test_a_file_that_is_written_again_stays_as_it_was_unless_it_is_the_same(tmp_path: Path) -> None:
    path = tmp_path / "study.csv"
    for text in ("one", "one", "two"):
        with earlier_kept(path):
            path.write_text(text)
    [aside] = tmp_path.glob("study.csv.replaced-*")
    assert aside.read_text() == "one" and path.read_text() == "two"


def fill_disk(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """Nothing more can be written; files can still be made and renamed, as on a real one."""

    def full(self: Path, *args: Any, **options: Any) -> int:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(Path, "write_text", full)


# --- nothing half-written is left, and what was there before stays until the new is whole


def test_a_file_appears_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "a.tar.gz"
    with atomic_file(path) as temporary:
        temporary.write_text("new")
        assert temporary.suffix == ".gz"
        assert not path.exists()
    assert path.read_text() == "new"
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


def test_impossible_paths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no folder"), atomic_file(tmp_path / "none" / "a.txt"):
        pass
    with pytest.raises(InputError, match="expected a file name, got a folder"), atomic_file(tmp_path):
        pass
