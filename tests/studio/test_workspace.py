"""The studio reads and writes inside its workspace only."""

import asyncio
import os
import unicodedata
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from checks import refusal

from posefuse.core import InputError
from posefuse.realtime.inputs import inputs_from_arguments
from posefuse_studio.setups import Setup, save_setup, setup_named, sources_of_setup
from posefuse_studio.workspace import StudioWorkspace, check_name, recording_place


@pytest.fixture
def workspace(tmp_path: Path) -> StudioWorkspace:
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "secret.txt").write_text("x", encoding="utf-8")
    (tmp_path / "inside").mkdir()
    return StudioWorkspace(tmp_path / "inside")


@pytest.mark.parametrize("name", ["", "..", "../outside/secret.txt", "a/../../b", "/etc/passwd", "C:/x", "a\\..\\b", "a\0b"])
def test_a_path_that_leaves_the_workspace_is_refused(workspace: StudioWorkspace, name: str) -> None:
    refusal(InputError, "inside the workspace", workspace.path, name)


def test_a_link_that_leaves_the_workspace_is_refused(workspace: StudioWorkspace) -> None:
    (workspace.root / "link").symlink_to(workspace.root.parent / "outside")
    refusal(InputError, "leads out", workspace.path, "link/secret.txt")
    assert workspace.files(".txt") == []


def test_paths_inside_are_found_and_named(workspace: StudioWorkspace) -> None:
    place = workspace.folder("a/b")
    (place / "c.toml").write_text("", encoding="utf-8")
    assert workspace.existing("a/b/c.toml") == place / "c.toml"
    assert workspace.name_of(place / "c.toml") == "a/b/c.toml"
    assert workspace.files(".toml") == ["a/b/c.toml"]
    refusal(InputError, "not in the workspace", workspace.existing, "a/b/d.toml")
    refusal(InputError, "not inside", workspace.name_of, workspace.root.parent / "outside")


def test_a_free_name_is_free(workspace: StudioWorkspace) -> None:
    assert workspace.free_name("rigs", "rig", ".toml") == "rigs/rig.toml"
    workspace.path("rigs/rig.toml").touch()
    assert workspace.free_name("rigs", "rig", ".toml") == "rigs/rig-2.toml"


@pytest.mark.parametrize(
    "name",
    ["", ".hidden", "a/b", "a\\b", "con", "NUL.txt", "x" * 81, "trailing.", " a", "-rf", "a:b", "a=b", "a?", "a\nb", "\u202e"],
)
def test_names_that_are_not_plain_are_refused(name: str) -> None:
    with pytest.raises(InputError):
        check_name(name)


@pytest.mark.parametrize(
    "name", ["Müller Gang", "Gang Müller (1)", "gang [2].mp4", "Köln_links-2", "歩行 1", "trial & error, 50 %"]
)
def test_names_of_people_and_places_are_taken(workspace: StudioWorkspace, name: str) -> None:
    check_name(name)
    # also as macOS writes them
    check_name(unicodedata.normalize("NFD", name))
    assert workspace.folder(name).is_dir()
    save_setup(workspace, Setup(name=name, sources={name: "usb:/dev/video0"}))
    inputs = inputs_from_arguments(sources_of_setup(workspace, setup_named(workspace, name)), None)
    assert [entry.camera for entry in inputs] == [name]


@pytest.mark.skipif(os.name == "nt", reason="Windows has no colon in names")
def test_a_folder_with_a_colon_that_is_there_can_be_opened(workspace: StudioWorkspace) -> None:
    (workspace.root / "trial 10:30").mkdir()
    assert workspace.existing("trial 10:30").is_dir()


def test_an_upload_is_bounded_and_never_replaces_a_file(workspace: StudioWorkspace) -> None:
    async def parts() -> AsyncIterator[bytes]:
        for _ in range(3):
            yield b"1234"

    assert asyncio.run(workspace.upload("videos", "cam 1.mp4", parts())) == "videos/cam 1.mp4"
    assert asyncio.run(workspace.upload("videos", "cam 1.mp4", parts())) == "videos/cam 1-2.mp4"
    refusal(InputError, "more than", lambda: asyncio.run(workspace.upload("videos", "large.mp4", parts(), most_bytes=8)))
    assert sorted(path.name for path in (workspace.root / "videos").iterdir()) == ["cam 1-2.mp4", "cam 1.mp4"]
    assert (workspace.root / "videos" / "cam 1.mp4").read_bytes() == b"1234" * 3


def test_a_name_that_is_too_long_for_the_disk_is_of_no_file(workspace: StudioWorkspace) -> None:
    for name in ("x" * 300, "a/" * 3000 + "b"):
        refusal(InputError, "not in the workspace", workspace.existing, name)


def test_a_live_recording_is_known_by_its_folder() -> None:
    names = ("recordings/walk/recording.mcap", "recordings/walk/recording", "results/walk", "walk", "recording.mcap", "a.mcap")
    assert [recording_place(name).as_posix() for name in names] == [
        "recordings/walk", "recordings/walk/recording", "results/walk", "walk", "recording.mcap", "a.mcap",
    ]  # fmt: skip
