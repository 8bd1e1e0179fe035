"""The studio reads and writes inside its workspace only; presets and targets are files there, and keys lie outside of it."""

import asyncio
import os
import unicodedata
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from checks import refusal

from posefuse.calibration.targets.kinds import Charuco, Markers, read_target
from posefuse.core import InputError
from posefuse.realtime.inputs import inputs_from_arguments, shown_again
from posefuse.sources.video import length_s
from posefuse_studio import setups
from posefuse_studio.calibrations import print_targets, targets, without_floor
from posefuse_studio.jobs import JOBS_FOLDER, Jobs
from posefuse_studio.setups import DEMO, Setup, rig_of_setup, save_setup, setup_named, source_text, sources_of_setup
from posefuse_studio.work import JobReporter
from posefuse_studio.workspace import (
    SessionAddress,
    StudioWorkspace,
    address_file,
    check_name,
    private_folder,
    read_stored,
    recording_place,
    write_stored,
)


@pytest.mark.parametrize("name", ["", "..", "../outside/secret.txt", "a/../../b", "/etc/passwd", "C:/x", "a\\..\\b", "a\0b"])
def test_a_path_that_leaves_the_workspace_is_refused(workspace: StudioWorkspace, name: str) -> None:
    refusal(InputError, "inside the workspace", workspace.path, name)


def test_a_field_that_was_left_empty_is_refused_as_such(workspace: StudioWorkspace) -> None:
    refusal(InputError, "expected the name of a file or folder inside the workspace, got none", workspace.existing, "")


def test_a_link_that_leaves_the_workspace_is_refused(workspace: StudioWorkspace) -> None:
    (workspace.root.parent / "outside").mkdir()
    (workspace.root.parent / "outside" / "secret.txt").touch()
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

    for name in ("videos/cam 1.mp4", "videos/cam 1-2.mp4"):
        assert asyncio.run(workspace.upload("videos", "cam 1.mp4", parts())) == name
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


# --- presets name nothing outside of the workspace; targets are printed there


CAMERAS = {"left": "usb:/dev/video0", "right": "rtsp://camera/stream"}


def test_presets_are_kept(workspace: StudioWorkspace) -> None:
    setup = Setup(name="two webcams", sources=CAMERAS)
    save_setup(workspace, setup)
    assert setups.setups(workspace) == [Setup(name=DEMO), setup] and setup_named(workspace, "two webcams") == setup
    refusal(InputError, "not calibrated", rig_of_setup, workspace, setup)
    setups.delete_setup(workspace, "two webcams")
    assert setups.setups(workspace) == [Setup(name=DEMO)]


@pytest.mark.parametrize(
    "setup",
    [
        Setup(name=DEMO, sources=CAMERAS),
        Setup(name="../x", sources=CAMERAS),
        Setup(name="empty"),
        Setup(name="a", sources={"left": "video:../../secret.mp4"}),
        Setup(name="a", sources={"left": "sim:/etc/scene.yaml"}),
        Setup(name="a", sources={"../left": "usb:0"}),
    ],
)
def test_a_preset_that_cannot_be_is_refused(workspace: StudioWorkspace, setup: Setup) -> None:
    with pytest.raises(InputError):
        save_setup(workspace, setup)


def test_files_are_named_inside_the_workspace(workspace: StudioWorkspace) -> None:
    (workspace.root / "a.mp4").touch()
    assert source_text(workspace, "video:a.mp4") == f"video:{workspace.root / 'a.mp4'}"
    assert source_text(workspace, "usb:0") == "usb:0"
    # a session takes this kind in any letters
    refusal(InputError, "inside the workspace", source_text, workspace, f"VIDEO:{workspace.root / 'a.mp4'}")


def test_the_bundled_clip_is_a_setup_whose_videos_begin_again(workspace: StudioWorkspace) -> None:
    demo = setup_named(workspace, DEMO)
    rig = rig_of_setup(workspace, demo)
    inputs = shown_again(inputs_from_arguments(sources_of_setup(workspace, demo), rig), "shortest")
    assert [entry.camera for entry in inputs] == list(rig.names)
    [loop_s] = {entry.loop_s for entry in inputs}
    assert loop_s == min(length_s(entry.config.path) for entry in inputs) > 1
    assert {entry.loop_s for entry in shown_again(inputs, None)} == {None}


def test_targets_are_printed_with_what_describes_them(workspace: StudioWorkspace) -> None:
    sizes = {"marker_mm": 120, "columns": 5, "rows": 7, "square_mm": 36}
    cube, board = print_targets(workspace, sizes, "a4")
    assert read_target(workspace.existing(board)) == Charuco(columns=5, rows=7, square_m=0.036, marker_m=0.027)
    assert read_target(workspace.existing(cube)) == Markers(side_m=0.12, ids=(43, 44, 45, 46, 47, 48, 49))
    assert without_floor(read_target(workspace.existing(cube))) == Markers(side_m=0.12, ids=(44, 45, 46, 47, 48, 49))
    assert without_floor(read_target(workspace.existing(board))) == read_target(workspace.existing(board))
    for name in (cube, board):
        assert workspace.existing(name.replace(".toml", ".pdf")).read_bytes().startswith(b"%PDF")
    # again: there are still two
    print_targets(workspace, sizes, "a4")
    assert targets(workspace, "intrinsics") == [board] and targets(workspace, "extrinsics") == [cube]
    refusal(InputError, "a number in each field", print_targets, workspace, {"marker_mm": 120}, "a4")


# --- keys are for this user only; what another user could have written is not read


ADDRESS = SessionAddress(port=4711, key=bytes(range(32)))


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stands for the user's folder of state."""
    monkeypatch.setattr("posefuse_studio.workspace.platformdirs.user_state_dir", lambda *_, **__: str(tmp_path / "state"))
    return tmp_path / "state"


def test_a_key_is_outside_of_the_workspace_and_private(workspace: StudioWorkspace, state: Path) -> None:
    workspace.folder(f"{JOBS_FOLDER}/one")
    reporter = JobReporter(workspace, "one")
    assert Jobs(workspace).address("one") is None
    reporter.listens(ADDRESS)
    [file] = [path for path in state.rglob("*") if path.is_file()]
    assert file.stat().st_mode & 0o777 == 0o600 and private_folder().stat().st_mode & 0o777 == 0o700
    assert Jobs(workspace).address("one") == ADDRESS
    texts = [path.read_text(encoding="utf-8") for path in workspace.root.rglob("*") if path.is_file()]
    assert texts and not any(ADDRESS.key.hex() in text or "4711" in text for text in texts)
    reporter.end(state="done")
    assert Jobs(workspace).address("one") is None and not file.exists()


def test_an_address_is_of_one_job_in_one_workspace(tmp_path: Path, state: Path) -> None:
    write_stored(address_file(tmp_path / "a", "one"), ADDRESS)
    assert read_stored(address_file(tmp_path / "a", "one"), SessionAddress) == ADDRESS
    for workspace, job in (("b", "one"), ("a", "two")):
        assert read_stored(address_file(tmp_path / workspace, job), SessionAddress) is None


@pytest.mark.parametrize(
    "text", ["{", "[]", "{}", '{"port": 1}', '{"port": [], "key": "00"}', '{"port": 1, "key": "xy"}', "[" * 10**5]
)
def test_a_damaged_address_is_none(tmp_path: Path, state: Path, text: str) -> None:
    file = address_file(tmp_path, "one")
    file.write_text(text, encoding="utf-8")
    assert read_stored(file, SessionAddress) is None


def test_what_another_user_has_written_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_stored(tmp_path / "a.json", {"a": 1})
    assert read_stored(tmp_path / "a.json", dict) == {"a": 1}
    monkeypatch.setattr("os.geteuid", lambda: tmp_path.stat().st_uid + 1, raising=False)
    for name in ("a.json", "", "missing.json"):
        assert read_stored(tmp_path / name, dict) is None
