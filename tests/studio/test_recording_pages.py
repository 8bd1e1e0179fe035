"""What the pages Recordings and Simulate are made of: curves, maps, files by address, the player, the jobs."""

import asyncio
import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from checks import refusal
from fastapi import FastAPI
from fastapi.testclient import TestClient
from small_session import COUNT, PERIOD_NS, SIZE_WH, grey, saved_session
from studio_messages import read_message

import posefuse as pf
from posefuse.core import ConfigError, Rig
from posefuse.formats.video import VideoWriter
from posefuse.foundation.settings import settings_from_mapping
from posefuse_sim import rig_plan
from posefuse_sim.build import live_scene
from posefuse_sim.cameras import PlacedCamera, placed_cameras
from posefuse_sim.scene import Scene, plain_settings, read_scene, scene_text
from posefuse_studio import work
from posefuse_studio.app import add_routes
from posefuse_studio.jobs import JOBS_FOLDER
from posefuse_studio.pages.recording import chart_options
from posefuse_studio.pages.simulate import RoomMap, error_map, nearest_camera, room_svg
from posefuse_studio.player import ResultPlayer, open_recording
from posefuse_studio.state import Stream
from posefuse_studio.workspace import StudioWorkspace


@pytest.fixture
def workspace(tmp_path: Path, ring_rig: Callable[..., Rig], monkeypatch: pytest.MonkeyPatch) -> StudioWorkspace:
    """With a session ``walk`` and its result ``result``."""
    monkeypatch.setenv("POSEFUSE_CACHE", str(tmp_path / "cache"))
    (tmp_path / "ws").mkdir()
    saved_session(tmp_path / "ws", ring_rig)
    return StudioWorkspace(tmp_path / "ws")


def test_a_curve_has_a_gap_where_values_are_missing_and_strikes_lie_below_it() -> None:
    t_s = np.linspace(3.0, 5.0, 20)
    values = np.sin(t_s)
    values[8:11] = np.nan
    options = chart_options((3.0, 5.0), t_s, {"left_knee": values}, {"left": np.array([3.5])})
    line, strikes = options["series"]
    assert [i for i, (_, value) in enumerate(line["data"]) if value is None] == [8, 9, 10]
    assert line["data"][0] == [3.0, pytest.approx(np.sin(3.0))] and options["legend"]["data"] == ["left knee"]
    assert (options["xAxis"]["min"], options["xAxis"]["max"]) == (3.0, 5.0)
    [[at_s, y]] = strikes["data"]
    assert at_s == 3.5 and y == options["yAxis"]["min"] < np.nanmin(values)


def test_a_timeline_without_curves_has_words() -> None:
    options = chart_options((0.0, 1.0), np.linspace(0, 1, 5), {}, {}, "No person was seen.")
    assert options["series"] == [] and options["title"]["text"] == "No person was seen." and not options["yAxis"]["show"]
    never = chart_options((0.0, 1.0), np.linspace(0, 1, 5), {"knee": np.full(5, np.nan)}, {})
    assert never["yAxis"]["min"] < never["yAxis"]["max"]


def test_a_long_recording_is_drawn_with_few_points() -> None:
    t_s = np.arange(18_000) / 30
    [line] = chart_options((0.0, 600.0), t_s, {"knee": np.sin(t_s)}, {})["series"]
    assert len(line["data"]) == 600


def test_the_room_map_is_inverse_and_stays_inside() -> None:
    room = RoomMap((6.0, 4.0))
    assert room.metres(*room.px(1.25, -1.5)) == (1.25, -1.5)
    assert room.metres(-999, 9999) == (-3.0, -2.0)
    assert room.px(0, 1)[1] < room.px(0, 0)[1]


def test_the_map_is_brighter_where_the_rig_is_more_exact() -> None:
    scene, room = rig_plan.first_plan(), RoomMap((7.0, 7.0))
    plan = rig_plan.plan_rig(rig_plan.rig_of_scene(scene), room.size_m, step_m=0.5)
    floor = error_map(plan)
    # a pixel a place of the plan, which begins at the near side
    brightness = cv2.cvtColor(floor, cv2.COLOR_BGR2GRAY)[::-1]
    assert brightness.shape == plan.error_map_mm.shape
    best, worst = (np.unravel_index(f(plan.error_map_mm), plan.error_map_mm.shape) for f in (np.nanargmin, np.nanargmax))
    assert brightness[best] > brightness[worst]
    drawn = room_svg(room, (), "", floor)
    image = base64.b64decode(drawn.partition("base64,")[2].partition('"')[0])
    assert np.array_equal(cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR), floor)
    (left, top), (right, bottom) = room.px(-3.5, 3.5), room.px(3.5, -3.5)
    place = f'x="{left:.0f}" y="{top:.0f}" width="{right - left:.0f}" height="{bottom - top:.0f}"'
    assert f"<image {place} " in drawn and f"<rect {place} " in drawn


def test_a_camera_is_found_where_it_is_drawn() -> None:
    room, cameras = RoomMap((7.0, 7.0)), placed_cameras(rig_plan.first_plan().cameras)
    for camera in cameras:
        assert nearest_camera(cameras, *room.px(*camera.position_m[:2]), room) == camera.name
    assert nearest_camera(cameras, *room.px(0, 0), room) == ""
    assert all(camera.name in room_svg(room, cameras, cameras[0].name) for camera in cameras)


def test_a_plan_is_changed_camera_by_camera() -> None:
    scene = rig_plan.first_plan(4)
    name = rig_plan.free_camera_name(scene)
    more = rig_plan.with_camera(scene, PlacedCamera(name=name, position_m=(0.0, -3.0, 2.0)))
    moved = rig_plan.with_camera(more, PlacedCamera(name=name, position_m=(1.0, -3.0, 2.0)))
    assert rig_plan.camera_of(moved, name).position_m == (1.0, -3.0, 2.0)
    assert rig_plan.without_camera(moved, name) == scene
    refusal(ConfigError, "own position", lambda: rig_plan.with_camera(scene, PlacedCamera(name=name, position_m=(0.0, 0.0, 1.0))))
    only = scene
    for camera in placed_cameras(scene.cameras)[1:]:
        only = rig_plan.without_camera(only, camera.name)
    refusal(ConfigError, "needs a camera", rig_plan.without_camera, only, "cam00")


def test_a_kept_plan_is_a_scene_file_that_can_be_rendered(tmp_path: Path) -> None:
    scene = rig_plan.with_test_walk(rig_plan.first_plan(), 2.0)
    (tmp_path / "plan.yaml").write_text(scene_text(scene), encoding="utf-8")
    read = read_scene(tmp_path / "plan.yaml")
    assert read == scene == settings_from_mapping(plain_settings(scene), Scene, where="plan")
    live_scene(read)  # cameras inside the room, no person walks through a wall


@pytest.fixture
def client(workspace: StudioWorkspace) -> TestClient:
    app = FastAPI()
    add_routes(app, workspace)
    return TestClient(app)


def test_a_small_picture_is_fetched_by_name(client: TestClient) -> None:
    answer = client.get("/studio/thumbnail", params={"name": "result"})
    assert answer.headers["content-type"] == "image/jpeg"
    assert cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR) is not None
    assert client.get("/studio/thumbnail", params={"name": "walk"}).status_code == 404
    assert client.get("/studio/file", params={"name": "result"}).status_code == 404


NO_FILES = ("../secret.txt", "/etc/passwd", "link", "nowhere.html", "x" * 300, "a/" * 3000 + "b", "\0", "", f"{JOBS_FOLDER}/a")


@pytest.mark.parametrize("name", NO_FILES, ids=range(len(NO_FILES)))
def test_no_file_outside_the_workspace_or_of_its_jobs_is_fetched(client: TestClient, workspace, name: str) -> None:
    secret, state = workspace.root.parent / "secret.txt", workspace.folder(JOBS_FOLDER) / "a"
    for file in (secret, state):
        file.write_text("what no page shows")
    (workspace.root / "link").symlink_to(secret)
    for kind in ("file", "thumbnail"):
        answer = client.get(f"/studio/{kind}", params={"name": name})
        assert answer.status_code == 404 and "what no page shows" not in answer.text


def test_a_page_of_the_workspace_can_do_nothing_to_the_studio(client: TestClient, workspace: StudioWorkspace) -> None:
    (workspace.root / "page.html").write_text("<script>1</script>")
    answer = client.get("/studio/file", params={"name": "page.html"})
    assert answer.headers["content-security-policy"].startswith("sandbox allow-scripts;")
    assert "allow-same-origin" not in answer.headers["content-security-policy"]
    assert client.get("/studio/file", params={"name": "result/rig.toml"}).headers["content-disposition"].startswith("attachment")


async def idle(player: ResultPlayer) -> None:
    while player._busy:
        await asyncio.sleep(0.01)


def played(workspace: StudioWorkspace, use: Callable, publish: Callable[[Any, bytes], object]) -> None:
    """Use a player of the result, which publishes its messages so."""
    opened, stream = open_recording(workspace.path("result"), workspace.root), Stream()
    stream.publish = lambda key, message, keep=False: publish(key, message)

    async def main() -> None:
        player = ResultPlayer(opened, stream)
        player.start()
        await use(player)
        player.close()

    asyncio.run(main())


def test_the_player_shows_the_moment_that_was_asked_for_last(workspace: StudioWorkspace) -> None:
    sent: list[tuple[object, bytes]] = []

    async def use(player: ResultPlayer) -> None:
        for i in (3, 25, 11):
            player.seek(i * PERIOD_NS / 1e9)
        await idle(player)
        player.step(2)
        assert player.t_s == pytest.approx(13 * PERIOD_NS / 1e9)
        await idle(player)
        player.seek(999.0)
        assert player.t_s == player.end_s

    played(workspace, use, lambda key, message: sent.append((key, message)))
    images = [read_message(message) for key, message in sent if key == ("image", 2)]
    assert all(one["kind"] == "image" for one in images)
    times = [round(one["t_s"] * 1e9 / PERIOD_NS) for one in images]
    assert times[-1] in (13, COUNT - 1) and 11 in times
    assert 3 not in times[1:]  # newer requests take its place
    poses = [message for key, message in sent if key == "pose"]
    assert all(read_message(message)["kind"] == "poses" for message in poses)


def test_a_recording_begins_where_there_are_images_and_states_where_there_are_none(workspace: StudioWorkspace) -> None:
    """As a live recording, whose videos begin a moment after its poses."""
    video, late = workspace.path("walk/videos/cam01.mp4"), 7
    with VideoWriter(video, SIZE_WH, 30.0, crf=5) as writer:
        for i in range(late, COUNT):
            writer.write(np.full((SIZE_WH[1], SIZE_WH[0], 3), grey(1, i), np.uint8), i * PERIOD_NS)
    sent: dict[object, bytes] = {}

    async def use(player: ResultPlayer) -> None:
        assert player.t_s == pytest.approx(late * PERIOD_NS / 1e9)
        await idle(player)
        assert read_message(sent["image", 1])["file"].startswith(b"\xff\xd8")
        player.seek(0.0)
        await idle(player)
        # the image of another time would be taken for that of this one
        empty = read_message(sent["image", 1])
        names = ("camera", "width", "height", "detections", "people", "keypoints", "file")
        assert [empty[name] for name in names] == [1, *SIZE_WH, 0, 0, 0, b""]
        assert read_message(sent["image", 0])["file"].startswith(b"\xff\xd8")

    played(workspace, use, sent.__setitem__)


def test_videos_outside_the_workspace_are_not_shown(workspace: StudioWorkspace) -> None:
    (workspace.root / "walk").rename(workspace.root.parent / "walk")
    opened = open_recording(workspace.path("result"), workspace.root)
    assert opened.at("cam00", 0, 480) is None
    assert pf.read(workspace.path("result")).provenance["session"] == "walk"


def test_jobs_write_into_the_workspace(workspace: StudioWorkspace) -> None:
    progress, export = Mock(), {"result": "result", "out": "exports/walk", "formats": ["trc", "csv"]}
    files = work.export_job(export, workspace, progress)["files"]
    assert {Path(name).suffix for name in files} >= {".trc", ".csv"}
    assert all(workspace.existing(name).is_file() for name in files)
    assert progress.called


def test_a_report_job_replaces_its_own_report(workspace: StudioWorkspace, monkeypatch: pytest.MonkeyPatch) -> None:
    def written(recording: pf.Recording, folder: Path, *_: object, **__: object) -> list[Path]:
        (folder / "report.html").write_text("page")
        return [folder / "report.html"]

    monkeypatch.setattr("posefuse.pipeline.writing.write_biomechanics", written)
    for _ in range(2):
        made = work.report_job({"result": "result"}, workspace, lambda *_: None)
        assert made == {"page": "result/biomechanics/report.html"}
