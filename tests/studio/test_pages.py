"""Pages are built and their controls act, by NiceGUI's simulated user: no browser."""

import asyncio
import sys
from collections.abc import Callable, Coroutine
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from checks import refusal
from nicegui import ui
from nicegui.testing import User, user_simulation
from small_session import saved_session

import posefuse as pf
from posefuse.core import ConfigError, InputError, OutputHealth, Rig
from posefuse.detection import named_networks
from posefuse.foundation import plugins
from posefuse_sim.build import room_size
from posefuse_sim.rig_plan import camera_of, rig_of_scene
from posefuse_sim.scene import read_scene
from posefuse_studio import app, work
from posefuse_studio.access import Access
from posefuse_studio.calibrations import Project, projects, save_project
from posefuse_studio.jobs import Jobs
from posefuse_studio.pages import PAGES
from posefuse_studio.pages.live import _session_light, recording_fault
from posefuse_studio.pages.recording import read_edits, write_edits
from posefuse_studio.pages.simulate import RoomMap
from posefuse_studio.session import CameraStatus, SessionStatus
from posefuse_studio.setups import Setup, save_setup, setup_named
from posefuse_studio.state import Studio
from posefuse_studio.workspace import StudioWorkspace

NETWORK = "rtmpose_m"


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Any]]:
    """The jobs that pages start: work and arguments; none runs."""
    found: list[tuple[str, Any]] = []
    monkeypatch.setattr(Jobs, "start", lambda self, work, title, arguments, **more: found.append((work, arguments)))
    return found


def visited(folder: Path, path: str, use: Callable[[User], Coroutine[Any, Any, None]]) -> None:
    """Use a page of the studio of a workspace."""
    studio = Studio(StudioWorkspace(folder), Access.of("127.0.0.1", 8765))

    async def main() -> None:
        async with user_simulation() as user:
            for page in PAGES:
                ui.page(page.path)(app._builder(studio, page))
            await user.open(path)
            await use(user)

    modules = dict(sys.modules)
    asyncio.run(main())
    # the simulation forgets the modules of pages, which other tests have
    sys.modules.update(modules)


def field(user: User, kind: type[Any], label: str) -> Any:
    """The field of a page with this label."""
    [found] = [one for one in user.find(kind).elements if one.props.get("label") == label]
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.title)
def test_every_page_of_a_new_workspace_is_built(tmp_path: Path, page: Any) -> None:
    async def use(user: User) -> None:
        await user.should_see(page.title)

    visited(tmp_path, page.path, use)


@pytest.mark.parametrize(
    ("path", "press", "why"),
    [
        ("/", "Show images", "Add a camera first"),
        ("/simulate", "Render the walk", "expected a name"),
        ("/recordings", "Track all", "not in the workspace"),
    ],
)
def test_a_page_shows_what_it_cannot_do(tmp_path: Path, started: list[tuple[str, Any]], path: str, press: str, why: str) -> None:
    async def use(user: User) -> None:
        if press == "Track all":
            user.find(kind=ui.button, content="Track a study").click()
            user.find("Folder in the workspace").type("nowhere")
        if press == "Render the walk":
            field(user, ui.input, "Name").set_value("a/b")
        user.find(kind=ui.button, content=press).click()
        await user.should_see(why)

    visited(tmp_path, path, use)
    assert started == []


@pytest.mark.parametrize("address", ["https://10.0.0.8/video.mjpg", "rtsps://10.0.0.7/stream", "usb:0", "thermal:7"])
def test_a_camera_is_added_by_its_address(tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "entry_points", lambda group: [EntryPoint("thermal", "others:Thermal", group)])

    async def use(user: User) -> None:
        user.find("e.g. rtsp://192.168.1.20/stream").type(address)
        user.find(kind=ui.button, content="Add").click()
        await user.should_see("cam1")

    visited(tmp_path, "/", use)


def test_another_preset_is_not_written_over(tmp_path: Path) -> None:
    workspace, earlier = StudioWorkspace(tmp_path), Setup(name="room", sources={"left": "usb:0"}, rig="rig.toml")
    save_setup(workspace, earlier)

    async def use(user: User) -> None:
        user.find("e.g. rtsp://192.168.1.20/stream").type("usb:1")
        user.find(kind=ui.button, content="Add").click()
        user.find(kind=ui.button, content="Save as preset").click()
        field(user, ui.input, "Name of the preset").set_value("room")
        save = user.find(kind=ui.button, content="Save")
        save.elements = {one for one in save.elements if one.text == "Save"}
        save.click()
        await user.should_see("room: there is a preset of this name already")
        field(user, ui.input, "Name of the preset").set_value("room 2")
        save.click()
        await user.should_see("Saved as room 2")

    visited(tmp_path, "/", use)
    assert setup_named(workspace, "room") == earlier and setup_named(workspace, "room 2").sources == {"cam1": "usb:1"}


def test_a_file_that_is_not_taken_as_a_video_is_refused_in_words(tmp_path: Path) -> None:
    async def use(user: User) -> None:
        [upload] = user.find(ui.upload).elements
        next(one for one in upload._event_listeners.values() if one.type == "rejected").handler()
        await user.should_see("Expected videos of at most 4 GB")

    visited(tmp_path, "/", use)


def test_a_dialog_is_no_part_of_what_is_drawn_again_below_it(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    save_setup(StudioWorkspace(tmp_path), Setup(name="webcams", sources={"left": "usb:0", "right": "usb:1"}))

    async def use(user: User) -> None:
        user.find(kind=ui.button, content="New calibration").click()
        user.find(kind=ui.button, content="Begin").click()
        await user.should_see("Print targets")

    visited(tmp_path, "/calibrate", use)
    assert list(projects(StudioWorkspace(tmp_path))) == ["room"] and "deleted" not in caplog.text


@pytest.mark.parametrize("seconds", [-5.0, 1e5])
def test_no_plan_is_kept_that_cannot_be_opened(tmp_path: Path, seconds: float) -> None:
    async def use(user: User) -> None:
        await user.should_see("Expected of these cameras", retries=100)
        field(user, ui.number, "Seconds").set_value(seconds)
        user.find(kind=ui.button, content="Keep this plan").click()
        await user.should_see("duration_s")

    visited(tmp_path, "/simulate", use)
    assert not list(tmp_path.rglob("*.yaml"))


def test_targets_of_typed_sizes_are_printed_and_chosen(tmp_path: Path) -> None:
    workspace = StudioWorkspace(tmp_path)
    save_setup(workspace, Setup(name="webcams", sources={"left": "usb:0", "right": "usb:1"}))
    save_project(workspace, Project(name="room", setup="webcams"))

    async def use(user: User) -> None:
        user.find(kind=ui.button, content="Print targets").click()
        # as a browser sends it
        field(user, ui.number, "down").set_value(6.0)
        user.find(kind=ui.button, content="Make PDF files").click()
        await user.should_see("Print at 100 %", retries=100)
        user.find(kind=ui.button, content="Use these").click()

    visited(tmp_path, "/calibrate", use)
    assert projects(workspace)["room"].board == "targets/board 5x6 36 mm.toml"
    assert {path.suffix for path in (tmp_path / "targets").iterdir()} == {".pdf", ".toml"}


def test_a_camera_of_a_plan_is_chosen_and_moved(tmp_path: Path) -> None:
    async def use(user: User) -> None:
        await user.should_see("Expected of these cameras", retries=100)
        user.find(kind=ui.button, content="Add a camera").click()
        field(user, ui.number, "x, m").set_value(1.5)
        user.find(kind=ui.button, content="Keep this plan").click()
        await user.should_see("Kept as plans/test-walk.yaml")

    visited(tmp_path, "/simulate", use)
    [plan] = (tmp_path / "plans").glob("*.yaml")
    assert camera_of(read_scene(plan), "cam04").position_m == (1.5, -3.5, 2.2)


def test_a_plan_is_opened_again_in_its_own_room(tmp_path: Path) -> None:
    (tmp_path / "plans").mkdir()
    own = tmp_path / "plans" / "own.yaml"
    own.write_text(
        "duration_s: 2\ncameras: {kind: list, cameras: [{name: a, position_m: [3, 9, 2]}, {name: b, position_m: [-3, 9, 2]}]}\n"
    )
    scene = read_scene(own)
    size_m = room_size(scene, rig_of_scene(scene))

    async def use(user: User) -> None:
        await user.should_see("Expected of these cameras", retries=100)
        user.find(kind=ui.button, content="Keep this plan").click()
        await user.should_see("Kept as plans/test-walk.yaml")
        earlier = field(user, ui.select, "Earlier plan")
        assert earlier.options == ["plans/own.yaml", "plans/test-walk.yaml"]
        earlier.set_value("plans/own.yaml")
        # the same figures as on the command line
        await user.should_see(dict(pf.plan(own).summary()[1].shown)["floor"], retries=100)
        (drawn,) = user.find(kind=ui.interactive_image).elements
        assert drawn.props["size"] == RoomMap(size_m).size_px
        user.find(kind=ui.button, content="Keep this plan").click()
        await user.should_see("Kept as plans/test-walk-2.yaml")

    visited(tmp_path, "/simulate", use)
    assert read_scene(tmp_path / "plans" / "test-walk-2.yaml").room.size_m == size_m


def test_what_fails_within_a_page_is_shown_there(tmp_path: Path) -> None:
    async def use(user: User) -> None:
        with user:
            ui.button("Fail", on_click=lambda: 1 // 0)
        user.find(kind=ui.button, content="Fail").click()
        await user.should_see("this is a bug of the studio")

    visited(tmp_path, "/calibrate", use)


def test_a_live_session_has_the_network_that_was_chosen(tmp_path: Path, started: list[tuple[str, Any]]) -> None:
    async def use(user: User) -> None:
        user.find(kind=ui.button, content="Start").click()
        field(user, ui.select, "Network").set_value(NETWORK)
        user.find(kind=ui.button, content="Start").click()

    visited(tmp_path, "/live", use)
    assert [(work, arguments["networks"]) for work, arguments in started] == [("live", ""), ("live", NETWORK)]


def test_a_study_has_the_network_that_was_chosen(tmp_path: Path, started: list[tuple[str, Any]], monkeypatch) -> None:
    (tmp_path / "study").mkdir()

    async def use(user: User) -> None:
        user.find(kind=ui.button, content="Track a study").click()
        user.find("Folder in the workspace").type("study")
        field(user, ui.select, "Network").set_value(NETWORK)
        user.find(kind=ui.button, content="Track all").click()

    visited(tmp_path, "/recordings", use)
    [(_, arguments)] = started
    tracked: list[Any] = []
    study = SimpleNamespace(failed={}, trials=(), table=tmp_path / "study")
    monkeypatch.setattr(work.pf, "batch", lambda *_, networks, **__: [tracked.append(networks), study][1])
    for one in (arguments, {**arguments, "networks": ""}):
        work.batch_job(one, StudioWorkspace(tmp_path), lambda *_: None)
    assert tracked == [NETWORK, None]


def test_a_recording_that_is_not_written_is_named_on_the_page_and_on_the_phone() -> None:
    gone = OutputHealth(state="failed", text="the file is gone")
    recording = SessionStatus(
        cameras={"a": CameraStatus(light="good", state="ok")}, recording="recordings/a", outputs={"record": gone}
    )
    assert recording_fault(recording) == "not recorded, failed: the file is gone"
    assert _session_light(recording) == ("bad", recording_fault(recording))
    for well in (
        replace(recording, outputs={"record": OutputHealth()}),  # it was opened again
        replace(recording, outputs={}),  # videos alone
        replace(recording, recording=""),  # an earlier one
    ):
        assert (recording_fault(well), _session_light(well)[0]) == ("", "good")


def test_names_that_were_given_to_people_are_there_when_the_page_is_opened_again(
    tmp_path: Path, ring_rig: Callable[..., Rig]
) -> None:
    write_edits(saved_session(tmp_path, ring_rig)[1], pf.Edits(names=("Grace",)))

    async def use(user: User) -> None:
        await user.should_see("Name of person 0", retries=100)
        assert field(user, ui.input, "Name of person 0").value == "Grace"
        assert field(user, ui.select, "Keep").options[0] == "Grace"

    visited(tmp_path, "/recordings?open=result", use)


def test_corrections_of_two_pages_are_all_kept(tmp_path: Path, ring_rig: Callable[..., Rig]) -> None:
    result = saved_session(tmp_path, ring_rig)[1]
    elsewhere = pf.Exclusion(start_s=0.1, end_s=0.2, camera="cam01")

    async def use(user: User) -> None:
        await user.should_see("Name of person 0", retries=100)
        write_edits(result, pf.Edits(exclusions=(elsewhere,)))
        field(user, ui.input, "Name of person 0").set_value("Grace")

    visited(tmp_path, "/recordings?open=result", use)
    assert read_edits(result) == pf.Edits(exclusions=(elsewhere,), names=("Grace",))


def test_corrections_that_others_wrote_are_never_written_over(tmp_path: Path) -> None:
    (tmp_path / "edits.json").write_text('{"mine": 1}')
    refusal(InputError, "not edits of posefuse", write_edits, tmp_path, pf.Edits(person=0))
    assert (tmp_path / "edits.json").read_text() == '{"mine": 1}'
    (tmp_path / "edits.json").write_text('{"format": "posefuse edits", "person": -2}')
    refusal(ConfigError, "person", read_edits, tmp_path)


def test_corrections_of_a_live_session_lie_next_to_it(tmp_path: Path) -> None:
    live = tmp_path / "walk.mcap"
    live.write_bytes(b"")
    assert read_edits(live) is None
    write_edits(live, pf.Edits(person=3))
    assert (tmp_path / "walk.edits.json").is_file() and read_edits(live) == pf.Edits(person=3)


def test_no_files_are_made_of_no_format(tmp_path: Path, ring_rig: Callable[..., Rig], started: list[tuple[str, Any]]) -> None:
    saved_session(tmp_path, ring_rig)

    async def use(user: User) -> None:
        await user.should_see("Formats", retries=100)
        field(user, ui.select, "Formats").set_value([])
        user.find(kind=ui.button, content="Export").click()
        await user.should_see("Choose a format")

    visited(tmp_path, "/recordings?open=result", use)
    assert started == []


def test_networks_are_those_that_find_keypoints() -> None:
    assert {NETWORK, "blazepose_best"} <= {*named_networks()} and "blazepose_persons" not in named_networks()
