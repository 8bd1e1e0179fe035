"""Left has one colour, and right another, in everything that is drawn: read out of the outputs themselves."""

import colorsys
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from packages import source_files
from posefuse.core import Recording
from posefuse.core.palette import LEFT, LEGEND, PEOPLE, RIGHT
from posefuse.evaluation.report import write_report
from posefuse.formats.page import Heading, Page
from posefuse.formats.page.write import page_html
from posefuse.kinematics import joints_from_poses
from posefuse.outputs import write_outputs
from posefuse.outputs.overlay import OverlaySink
from posefuse.outputs.overview import OverviewSink
from posefuse.outputs.rerun import RerunSink
from posefuse.outputs.rerun_scene import keypoint_colours
from posefuse_ros.markers import side_colours
from posefuse_studio.pages.recording import COLOURS
from posefuse_studio.scene.messages import scene_setup

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
    found = [re.findall(rf"--{side}: (#[0-9a-f]{{6}})", css) for side in ("left", "right")]
    assert [len(values) for values in found] == [2, 2]
    for left, right in zip(*found, strict=True):
        assert_sides(left, right)


def test_the_words_of_report_and_study_are_those_of_the_palette(tmp_path: Path, make_recording: Callable[..., Recording]) -> None:
    recording = make_recording(times=30)
    page = write_report(recording, joints_from_poses(recording.poses), tmp_path / "report.html").read_text()
    assert LEGEND in page and "Blue: left" not in page
    for path in source_files():
        assert path.name == "palette.py" or not re.search(r"(range|[Bb]lue): left", path.read_text(encoding="utf-8"))


def test_markers_for_rviz_and_foxglove_the_3d_viewer_and_the_studio(make_recording: Callable[..., Recording]) -> None:
    assert_sides(*map(tuple, side_colours(("left_hip", "right_hip"))))
    skeleton = make_recording().poses.skeleton
    of = dict(zip(skeleton.keypoints, keypoint_colours(skeleton), strict=True))
    assert_sides(*(tuple(channel / 255 for channel in of[f"{side}_hip"]) for side in ("left", "right")))
    assert_sides(COLOURS["left"], COLOURS["right"])


def test_the_3d_scene_of_the_studio_and_its_legend(make_recording: Callable[..., Recording]) -> None:
    skeleton = make_recording().poses.skeleton
    setup = scene_setup(skeleton=skeleton)
    of = dict(zip(skeleton.keypoints, setup["keypoint_rgb"], strict=True))
    assert_sides(*(tuple(channel / 255 for channel in of[f"{side}_hip"]) for side in ("left", "right")))
    assert_sides(setup["sides"]["left"], setup["sides"]["right"])


def test_what_a_written_rerun_recording_holds(tmp_path: Path, make_recording: Callable[..., Recording]) -> None:
    """Points and bones of the first time step in 3D, and bones in an image, read by Rerun's own reader."""
    reader = pytest.importorskip("rerun.chunk", reason="needs the extra `viewer`")
    recording = make_recording()
    [path] = write_outputs([RerunSink(image_px=0).build()], recording, tmp_path)
    rows = {chunk.entity_path: chunk.to_record_batch().to_pydict() for chunk in reader.RrdReader(path).stream()}

    def colours(entity: str, archetype: str) -> list[tuple[float, ...]]:
        return [
            tuple(channel / 255 for channel in value.to_bytes(4, "big")[:3]) for value in rows[entity][f"{archetype}:colors"][0]
        ]

    points = dict(
        zip(
            rows["/world/people/0/keypoints"]["Points3D:labels"][0], colours("/world/people/0/keypoints", "Points3D"), strict=True
        )
    )
    for part in ("shoulder", "hip"):
        assert_sides(points[f"left_{part}"], points[f"right_{part}"])
    for entity, archetype in (("/world/people/0/bones", "LineStrips3D"), ("/world/cameras/cam00/skeleton", "LineStrips2D")):
        bones = dict(zip(recording.poses.skeleton.bones, colours(entity, archetype), strict=True))
        assert_sides(bones["left_shoulder", "left_hip"], bones["right_shoulder", "right_hip"])


def test_the_curves_of_the_live_page() -> None:
    pytest.importorskip("nicegui", reason="the extra studio is not installed")
    from posefuse_studio.scene.view import curves

    assert_sides(*curves([0, 1], ["left_knee flexion", "right_knee flexion"])["colours"])


def test_people_have_no_colour_of_a_side() -> None:
    for rgb in PEOPLE:
        assert min(np.abs(np.subtract(rgb, side.image_rgb)).max() for side in (LEFT, RIGHT)) > 60


@pytest.mark.parametrize("sink", [OverlaySink(width_px=1280, height_px=960), OverviewSink()], ids=lambda sink: sink.name)
def test_pictures_name_the_colours(
    tmp_path: Path, make_recording: Callable[..., Recording], sink: OverlaySink | OverviewSink
) -> None:
    """Without a person, only the words of the legend have these colours."""
    poses = make_recording().poses
    gone = replace(poses, xyz_world=np.full_like(poses.xyz_world, np.nan), kind=np.zeros_like(poses.kind))
    [path] = write_outputs([sink], replace(make_recording(), poses=gone), tmp_path)
    if path.suffix == ".png":
        image = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    else:
        with av.open(str(path)) as video:
            image = next(video.decode(video=0)).to_ndarray(format="rgb24")
    for side in (LEFT, RIGHT):
        assert (np.abs(image.astype(int) - side.image_rgb).max(axis=-1) < 60).sum() > 8
