"""Outputs one looks at: that the right things are in them, in the right place, at the right time."""

import colorsys
import itertools
import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from studio_messages import read_message

from packages import source_files
from posefuse.core import InputError, Kind, Recording, Sink
from posefuse.core.palette import LEFT, LEGEND, MIDDLE, PEOPLE, RIGHT
from posefuse.evaluation.report import write_report
from posefuse.formats.page import Heading, Page
from posefuse.formats.page.page import page_html
from posefuse.formats.video import VideoWriter
from posefuse.kinematics import joints_from_poses
from posefuse.outputs import FrameSink, write_outputs
from posefuse.outputs.data_files import TrcSink
from posefuse.outputs.drawing import bone_colours, draw_skeleton, draw_view, grid_for, image_tile, view_tile
from posefuse.outputs.frames import every_time_step
from posefuse.outputs.overlay import Background, OverlaySink
from posefuse.outputs.overview import OverviewSink, best_time_step, bystander, stage_picture
from posefuse.outputs.provenance import person_file
from posefuse.outputs.rerun import RerunSink, keypoint_colours
from posefuse_ros.markers import side_colours
from posefuse_studio.pages.recording import chart_options
from posefuse_studio.scene_messages import setup_message

Make = Callable[..., Recording]
Frames = Callable[[Recording], Iterator]


def test_the_caller_waits_while_too_many_images_wait_to_be_written() -> None:
    begin, most = threading.Event(), threading.Event()
    work = Background(lambda: begin.wait(10), "test")
    caller = threading.Thread(target=lambda: ([work.call() for _ in range(4)], most.set()))
    caller.start()
    assert not most.wait(0.2)
    begin.set()
    assert most.wait(10)
    caller.join(10)
    work.close()


def decoded(path: Path) -> list[av.VideoFrame]:
    with av.open(str(path)) as container:
        return list(container.decode(video=0))


def test_the_video_has_every_time_step_at_its_time_and_tiles_of_every_camera(
    tmp_path: Path, make_recording: Make, grey_frames: Frames
) -> None:
    recording = make_recording(cameras=3)
    [path] = write_outputs([OverlaySink(width_px=640, height_px=480).build()], recording, tmp_path, grey_frames(recording))
    assert list(tmp_path.iterdir()) == [path]
    frames = decoded(path)
    assert [round(frame.time * 1e9) for frame in frames] == (recording.poses.t_ns - recording.poses.t_ns[0]).tolist()
    with av.open(str(path)) as container:
        codec = container.streams.video[0].codec_context
        assert (codec.name, codec.pix_fmt) == ("h264", "yuv420p")
    first, second = (frame.to_ndarray(format="rgb24") for frame in frames[:2])
    grid = grid_for([camera.size_wh for camera in recording.rig], (640, 480))
    for c in range(3):
        left, top = grid.corner(c)
        corner = (slice(top + grid.tile_wh[1] - 12, top + grid.tile_wh[1] - 2), slice(left + 2, left + 12))
        np.testing.assert_allclose(first[corner].mean(), 100 + c, atol=6)
    # camera 0 has no frame at time step 1
    assert second[grid.tile_wh[1] - 12 : grid.tile_wh[1] - 2, 2:12].mean() < 60


def black(recording: Recording) -> np.ndarray:
    """An image of its cameras."""
    return np.zeros((*recording.rig.cameras[0].size_wh[::-1], 3), np.uint8)


def unseen(recording: Recording) -> Recording:
    return replace(recording, observations=recording.observations.keeping([]))


def test_the_skeleton_lies_where_the_camera_projects_it(make_recording: Make) -> None:
    recording = make_recording(cameras=3)
    camera = recording.rig.cameras[1]
    for factor in (1, 2):
        tile_wh = (camera.size_wh[0] // factor, camera.size_wh[1] // factor)
        tile = view_tile(unseen(recording), 0, 1, black(recording), tile_wh)
        for keypoint, colour in (("left_hip", LEFT.image_rgb), ("right_shoulder", RIGHT.image_rgb), ("nose", MIDDLE.image_rgb)):
            xyz = recording.poses.xyz_world[0, 0, recording.poses.skeleton.index(keypoint)]
            x, y = np.round((camera.project(xyz) + 0.5) / factor - 0.5).astype(int)
            np.testing.assert_allclose(tile[y, x], colour, atol=12)


def test_a_view_is_drawn_into_its_part_of_a_larger_image(make_recording: Make) -> None:
    recording = make_recording(cameras=3)
    image = np.random.default_rng(3).integers(0, 255, (480, 640, 3), np.uint8)
    for given, (width, height) in ((image, (640, 480)), (image, (320, 300)), (None, (320, 300))):
        whole = np.full((height + 9, width + 13, 3), 77, np.uint8)
        draw_view(whole[4 : 4 + height, 6 : 6 + width], recording, 0, 1, given)
        tile = whole[4 : 4 + height, 6 : 6 + width].copy()
        np.testing.assert_array_equal(tile, view_tile(recording, 0, 1, given, (width, height)))
        whole[4 : 4 + height, 6 : 6 + width] = 77
        assert (whole == 77).all()


def test_raw_detections_and_gaps_are_marked(make_recording: Make) -> None:
    recording = make_recording(cameras=3)
    size, image = recording.rig.cameras[0].size_wh, black(recording)
    moved = replace(recording, observations=replace(recording.observations, xy_img=recording.observations.xy_img + 40))
    tile = view_tile(moved, 0, 0, image, size)
    x, y = np.round(moved.views.xy_img[0, 0, 0, 3]).astype(int)
    assert tile[y, x].min() > 150
    blank = view_tile(moved, 0, 2, image, size)
    assert blank[y, x].max() == 0
    # text on a dark ground names what is missing: more is written where a keypoint is
    middle = len(recording.poses) // 2
    assert (view_tile(recording, middle, 0, image, size)[25:60, :200] > 100).sum() > 100
    assert (view_tile(recording, 0, 0, image, size)[25:60, :200] > 100).sum() == 0


def test_only_where_every_image_was_looked_at_is_a_missing_person_named(make_recording: Make) -> None:
    recording = make_recording(cameras=3)
    log = recording.observations.only(np.zeros(len(recording.observations.frame_step), bool))
    live = replace(log, step_t_ns=log.step_t_ns[:0])
    for observations, least, most in ((log, 101, np.inf), (live, 0, 0)):
        tile = view_tile(replace(recording, observations=observations), 0, 0, black(recording), (640, 480))
        assert least <= (tile[25:45, :200, 0] > 100).sum() <= most


def test_what_is_not_measured_is_hollow(make_recording: Make) -> None:
    skeleton = make_recording().poses.skeleton
    xy = np.array([[30.0, 30], [100, 30], [30, 200], [100, 200], [180, 120]])
    for kind, filled in ((Kind.FUSED, True), (Kind.SMOOTHED, True), (Kind.INTERPOLATED, False), (Kind.PREDICTED, False)):
        tile = np.zeros((700, 300, 3), np.uint8)
        draw_skeleton(tile, xy, np.full(5, kind), skeleton)
        assert tile[30, 30].any() == filled
    tile = np.zeros((700, 300, 3), np.uint8)
    draw_skeleton(tile, np.full((5, 2), np.nan), np.full(5, Kind.MISSING), skeleton)
    draw_skeleton(tile, np.full((5, 2), 1e12), np.full(5, Kind.FUSED), skeleton)
    assert not tile.any()


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 16])
@pytest.mark.parametrize("size_wh", [(1920, 1080), (1080, 1920), (640, 480), (33, 17)])
def test_tiles_fit_and_do_not_overlap(count: int, size_wh: tuple[int, int]) -> None:
    grid = grid_for([size_wh] * count, (1280, 960))
    assert (np.array(grid.size_wh) <= [1280, 960]).all() and not np.any(np.array(grid.size_wh) % 2)
    assert grid.tile_wh[0] <= size_wh[0]
    corners = {grid.corner(place) for place in range(count)}
    assert len(corners) == count
    assert all((np.add(corner, grid.tile_wh) <= grid.size_wh).all() for corner in corners)


def test_a_tile_keeps_the_images_shape() -> None:
    image = np.full((100, 50, 3), 200, np.uint8)
    tile, scale = image_tile(image, (50, 100), (80, 80))
    assert scale == 0.8
    assert (tile[:, :40] == 200).all()
    assert (tile[:, 40:] < 60).all()


def test_overview(tmp_path: Path, make_recording: Make, grey_frames: Frames) -> None:
    recording = make_recording(cameras=3)
    [path] = write_outputs([OverviewSink(width_px=640, height_px=480)], recording, tmp_path, grey_frames(recording))
    picture = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    grid = grid_for([camera.size_wh for camera in recording.rig], (640, 480))
    assert picture.shape[0] == grid.size_wh[1]
    assert picture.shape[1] > grid.size_wh[0]
    assert abs(int(picture[grid.tile_wh[1] - 3, 3, 0]) - 100) < 3


def test_the_best_time_step_is_whole_and_near_the_middle(make_recording: Make) -> None:
    recording = make_recording(times=7)
    assert (recording.poses.kind[best_time_step(recording)] == Kind.FUSED).all()
    assert best_time_step(recording) in (2, 4)


def test_the_bystander_sees_everything(make_recording: Make) -> None:
    recording = make_recording(cameras=5)
    view = bystander(recording, 0, (400, 300))
    points = np.concatenate([recording.rig.centres_world(), recording.poses.xyz_world[0].reshape(-1, 3)])
    xy = view.project(points)
    assert (xy > 0).all() and (xy < [400, 300]).all()
    up = view.project(np.array([0, 0, 2.0])) - view.project(np.zeros(3))
    assert up[1] < -20
    assert abs(up[0]) < 1


def test_uncertainty_is_drawn_to_scale(make_recording: Make) -> None:
    recording = make_recording()
    wide = replace(recording, poses=replace(recording.poses, cov_world=recording.poses.cov_world * 100))
    narrow = replace(recording, poses=replace(recording.poses, cov_world=recording.poses.cov_world * 1e-6))
    least, usual, most = (stage_picture(one, 0, (400, 300)) for one in (narrow, recording, wide))
    assert (usual != least).any(axis=-1).sum() < (most != least).any(axis=-1).sum()


def test_a_refused_calibration_is_written_into_the_picture(make_recording: Make) -> None:
    recording = make_recording()
    refused = replace(recording, rig=replace(recording.rig, refused="corners fit"))
    changed = (stage_picture(recording, 0, (400, 300)) != stage_picture(refused, 0, (400, 300))).any(axis=-1)
    assert changed[:60].any() and not changed[60:].any()


def without_person(recording: Recording) -> Recording:
    gone = {"xyz_world": np.full_like(recording.poses.xyz_world, np.nan), "kind": np.zeros_like(recording.poses.kind)}
    return replace(recording, poses=replace(recording.poses, **gone))


def test_one_pass_feeds_all_outputs(tmp_path: Path, make_recording: Make, grey_frames: Frames) -> None:
    recording = make_recording()
    asked: list[int] = []
    counted = (asked.append(t_ns) or (t_ns, frames) for t_ns, frames in grey_frames(recording))
    sinks = [TrcSink(), OverlaySink(width_px=320, height_px=240), OverviewSink(width_px=320, height_px=240)]
    assert all(isinstance(sink, Sink) for sink in sinks)
    assert [isinstance(sink, FrameSink) for sink in sinks] == [False, True, True]
    made = write_outputs(sinks, recording, tmp_path, counted)
    assert [path.name for path in made] == ["pose.trc", "overlay.mp4", "overview.png"]
    assert asked == recording.poses.t_ns.tolist()


@pytest.mark.parametrize("sinks", [(OverlaySink(width_px=320, height_px=240), OverviewSink()), (RerunSink(),)])
def test_a_pass_that_fails_leaves_no_file(tmp_path: Path, make_recording: Make, grey_frames: Frames, sinks: tuple) -> None:
    if RerunSink() in sinks:
        pytest.importorskip("rerun", reason="needs the extra `viewer`")
    recording = make_recording()

    def broken() -> Iterator:
        yield from list(grey_frames(recording))[:3]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_outputs(sinks, recording, tmp_path, broken())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("half", ["converted", "encode"])
def test_a_video_that_cannot_be_written_is_reported_and_removed(
    tmp_path: Path, make_recording: Make, grey_frames: Frames, monkeypatch: pytest.MonkeyPatch, half: str
) -> None:
    recording, whole = make_recording(), getattr(VideoWriter, half)
    calls = itertools.count()

    def full(self: VideoWriter, *args: object) -> object:
        if next(calls) == 2:
            raise InputError("the disk is full")
        return whole(self, *args)

    monkeypatch.setattr(VideoWriter, half, full)
    with pytest.raises(InputError, match="the disk is full"):
        write_outputs([OverlaySink(width_px=320, height_px=240)], recording, tmp_path, grey_frames(recording))
    assert list(tmp_path.iterdir()) == []


def test_frames_find_their_time_step(make_recording: Make) -> None:
    recording = make_recording(times=4, cameras=2)
    t_ns = recording.poses.t_ns
    times = [t_ns[0] - 30_000_000, t_ns[0] + 5_000_000, t_ns[2] - 15_000_000, t_ns[3] + 25_000_000]
    got = dict(every_time_step(recording, zip(times, [("early",), ("first",), ("third",), ("late",)], strict=True)))
    assert got == {0: ("first",), 1: (None, None), 2: ("third",), 3: (None, None)}


def named(recording: Recording, *names: str) -> Recording:
    return replace(recording, provenance={**recording.provenance, "config": {"names": names}})


def test_people_are_named_where_there_are_several_or_names(make_recording: Make) -> None:
    alone, two = make_recording(), make_recording(people=(0, 1))
    assert two.person_names == ("person 0", "person 1")
    assert named(two, "Anna", "Björn").person_names == ("Anna", "Björn")
    assert named(make_recording(people=(1, 7)), "Anna", "Björn").person_names == ("Björn", "person 7")
    assert two.provenance["config"] == {"fuse": "all"} and named(alone, "Anna").person_names == ("Anna",)

    def tile(recording: Recording) -> np.ndarray:
        return view_tile(recording, 3, 0, None, (640, 480))

    assert (tile(alone) == tile(make_recording(people=(9,)))).all(), "one person needs no name"
    for one, other in ((alone, named(alone, "Anna")), (two, named(two, "Anna", "Björn"))):
        written = (tile(one) != tile(other)).any(axis=(1, 2))
        highest = [np.nanmin(one.rig.cameras[0].project(xyz)[:, 1]) for xyz in one.poses.xyz_world[3]]
        assert written.any() and np.flatnonzero(written).max() < max(highest), "above the people"


def test_names_of_files_have_id_and_name(make_recording: Make) -> None:
    two = make_recording(people=(0, 3))
    assert [person_file(two, n, ".trc") for n in (0, 1)] == ["pose_person0.trc", "pose_person3.trc"]
    assert person_file(named(two, "Anna Ö. / 2"), 0, ".trc") == "pose_person0_anna_ö_2.trc"
    assert person_file(named(two, "../.."), 0, ".trc") == "pose_person0.trc"
    assert person_file(named(make_recording(), "Anna"), 0, ".trc") == "pose.trc"


# --- left has one colour, and right another, in everything that is drawn: read out of the outputs themselves


ORANGE, BLUE = (0.02, 0.11), (0.54, 0.62)
ROOT = Path(__file__).resolve().parents[2]


def hue(colour: str | tuple[float, ...]) -> float:
    if isinstance(colour, str):
        colour = tuple(int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return colorsys.rgb_to_hsv(*colour)[0]


def assert_sides(left: str | tuple[float, ...], right: str | tuple[float, ...]) -> None:
    assert ORANGE[0] < hue(left) < ORANGE[1] and BLUE[0] < hue(right) < BLUE[1]


def test_pages_on_light_and_dark_ground() -> None:
    css = page_html(Page("a", [Heading("b")]))
    lefts, rights = (re.findall(rf"--{side}: (#[0-9a-f]{{6}})", css) for side in ("left", "right"))
    assert len(lefts) == 2
    for left, right in zip(lefts, rights, strict=True):
        assert_sides(left, right)


def test_the_words_of_report_and_study_are_those_of_the_palette(tmp_path: Path, make_recording: Make) -> None:
    recording = make_recording(times=30)
    page = write_report(recording, joints_from_poses(recording.poses), tmp_path / "report.html").read_text()
    assert LEGEND in page and "Blue: left" not in page
    for path in source_files():
        assert path.name == "palette.py" or not re.search(r"(range|[Bb]lue): left", path.read_text(encoding="utf-8"))


def test_bones_markers_of_ros_the_3d_viewer_and_the_studio(make_recording: Make) -> None:
    skeleton = make_recording().poses.skeleton
    assert bone_colours(skeleton) == [MIDDLE.image_rgb, LEFT.image_rgb, RIGHT.image_rgb, MIDDLE.image_rgb]
    setup, sides = read_message(setup_message(skeleton=skeleton))["content"], skeleton.indices(["left_hip", "right_hip"])
    for colours in (keypoint_colours(skeleton), setup["keypoint_rgb"]):
        assert_sides(*(tuple(channel / 255 for channel in colours[k]) for k in sides))
    assert_sides(setup["sides"]["left"], setup["sides"]["right"])
    nothing, t_s = np.full(2, np.nan), np.arange(2.0)
    chart = chart_options((0.0, 1.0), t_s, {"left_hip": nothing, "right_hip": nothing}, {"left": t_s, "right": t_s})["series"]
    for left, right in (chart[:2], chart[2:]):
        assert_sides(left["color"], right["color"])
    assert_sides(*map(tuple, side_colours(("left_hip", "right_hip"))))


def test_what_a_written_rerun_recording_holds(tmp_path: Path, make_recording: Make) -> None:
    """Points and bones of the first time step in 3D, and bones in an image, read by Rerun's own reader."""
    reader = pytest.importorskip("rerun.chunk", reason="needs the extra `viewer`")
    recording = make_recording()
    [path] = write_outputs([RerunSink().build()], recording, tmp_path)
    rows = {chunk.entity_path: chunk.to_record_batch().to_pydict() for chunk in reader.RrdReader(path).stream()}

    def colours(entity: str, archetype: str) -> list[tuple[float, ...]]:
        values = rows[entity][f"{archetype}:colors"][0]
        return [tuple(channel / 255 for channel in value.to_bytes(4, "big")[:3]) for value in values]

    keypoints = "/world/people/0/keypoints"
    points = dict(zip(rows[keypoints]["Points3D:labels"][0], colours(keypoints, "Points3D"), strict=True))
    for part in ("shoulder", "hip"):
        assert_sides(points[f"left_{part}"], points[f"right_{part}"])
    for entity, archetype in (("/world/people/0/bones", "LineStrips3D"), ("/world/cameras/cam00/skeleton", "LineStrips2D")):
        bones = dict(zip(recording.poses.skeleton.bones, colours(entity, archetype), strict=True))
        assert_sides(bones["left_shoulder", "left_hip"], bones["right_shoulder", "right_hip"])


def test_the_curves_of_the_live_page() -> None:
    pytest.importorskip("nicegui", reason="the extra studio is not installed")
    from posefuse_studio.scene import curves

    assert_sides(*curves([0, 1], ["left_knee flexion", "right_knee flexion"])["colours"])


def test_people_have_no_colour_of_a_side() -> None:
    for rgb in PEOPLE:
        assert min(np.abs(np.subtract(rgb, side.image_rgb)).max() for side in (LEFT, RIGHT)) > 60


@pytest.mark.parametrize("sink", [OverlaySink(width_px=1280, height_px=960), OverviewSink()], ids=lambda sink: sink.name)
def test_pictures_name_the_colours(tmp_path: Path, make_recording: Make, sink: OverlaySink | OverviewSink) -> None:
    """Without a person, only the words of the legend have these colours."""
    [path] = write_outputs([sink], without_person(make_recording()), tmp_path)
    image = decoded(path)[0].to_ndarray(format="rgb24")
    hue, strength, light = np.moveaxis(cv2.cvtColor(image, cv2.COLOR_RGB2HSV), -1, 0)
    for least, most in (ORANGE, BLUE):
        assert ((least < hue / 180) & (hue / 180 < most) & (strength > 128) & (light > 100)).sum() > 8
