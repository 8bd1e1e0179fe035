"""Presets are files of the workspace and name nothing outside it; targets are printed there; blur is noticed."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from checks import refusal

from posefuse.calibration.targets.kinds import Charuco, Markers, read_target
from posefuse.core import InputError
from posefuse.realtime.inputs import inputs_from_arguments, shown_again
from posefuse.realtime.watching import detail_left, focus_warning
from posefuse.sources.video import length_s
from posefuse_studio.calibrations import print_targets, targets, without_floor
from posefuse_studio.setups import (
    DEMO,
    Setup,
    delete_setup,
    rig_of_setup,
    save_setup,
    setup_named,
    setups,
    source_text,
    sources_of_setup,
)
from posefuse_studio.workspace import StudioWorkspace

CAMERAS = {"left": "usb:/dev/video0", "right": "rtsp://camera/stream"}


@pytest.fixture
def workspace(tmp_path: Path) -> StudioWorkspace:
    return StudioWorkspace(tmp_path)


def test_presets_are_kept(workspace: StudioWorkspace) -> None:
    setup = Setup(name="two webcams", sources=CAMERAS)
    save_setup(workspace, setup)
    assert setups(workspace) == [Setup(name=DEMO), setup] and setup_named(workspace, "two webcams") == setup
    refusal(InputError, "not calibrated", rig_of_setup, workspace, setup)
    delete_setup(workspace, "two webcams")
    assert setups(workspace) == [Setup(name=DEMO)]


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
    cube, board = print_targets(workspace, sizes, "a4", "intrinsics")
    assert read_target(workspace.existing(board)) == Charuco(columns=5, rows=7, square_m=0.036, marker_m=0.027)
    assert read_target(workspace.existing(cube)) == Markers(side_m=0.12, ids=(43, 44, 45, 46, 47, 48, 49))
    assert without_floor(read_target(workspace.existing(cube))) == Markers(side_m=0.12, ids=(44, 45, 46, 47, 48, 49))
    assert without_floor(read_target(workspace.existing(board))) == read_target(workspace.existing(board))
    for name in (cube, board):
        assert workspace.existing(name.replace(".toml", ".pdf")).read_bytes().startswith(b"%PDF")
    assert targets(workspace, "intrinsics") == [board] and targets(workspace, "extrinsics") == [cube]
    # again: there are still two
    print_targets(workspace, sizes, "a4", "intrinsics")
    assert targets(workspace, "intrinsics") == [board] and targets(workspace, "extrinsics") == [cube]
    refusal(InputError, "a number in each field", print_targets, workspace, {"marker_mm": 120}, "a4", "intrinsics")


def test_blur_is_noticed_and_a_sharp_image_is_not_blamed() -> None:
    rng = np.random.default_rng(5)
    image = np.full((480, 640), 90, np.uint8)
    for _ in range(60):
        x, y = rng.integers(0, (560, 400))
        cv2.rectangle(image, (int(x), int(y)), (int(x) + 60, int(y) + 50), int(rng.integers(0, 255)), -1)
    image = cv2.GaussianBlur(image, (0, 0), 0.6)
    left = [detail_left(np.dstack([cv2.GaussianBlur(image, (0, 0), blur)] * 3)) for blur in (0.1, 1.0, 2.0, 4.0)]
    assert left == sorted(left)
    assert not focus_warning(np.dstack([image] * 3))
    assert "focus" in focus_warning(np.dstack([cv2.GaussianBlur(image, (0, 0), 3.0)] * 3))
    assert not focus_warning(np.full((480, 640, 3), 128, np.uint8))
