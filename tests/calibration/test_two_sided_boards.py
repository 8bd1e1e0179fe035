"""Boards printed on both sides, and inverted prints: against the simulated truth."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from bench.faults.waved_props import Faults, Waving, observe_prop
from posefuse.calibration.extrinsics.pipeline import Options, key_snapshots, link
from posefuse.calibration.extrinsics.self_checks import camera_differences
from posefuse.calibration.extrinsics.target import calibrate_extrinsics
from posefuse.calibration.solving.rotations import poses_of
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.detection import Corners, TargetDetector
from posefuse.calibration.targets.kinds import Charuco, TargetDescription, described_target, sides
from posefuse.calibration.targets.printing import Sheet, board_sheets
from posefuse.core import SE3, ConfigError, Rig

OPTIONS = Options(time_steps=50, clocks="together")
TWO_SIDED = Charuco(columns=5, rows=7, square_m=0.12, marker_m=0.09, thickness_m=0.01)


def worst_mm_and_deg(rig: Rig, found: Rig) -> tuple[float, float]:
    """Of the worst camera; where the world lies does not count, its scale does."""
    true, ours = (poses_of(one) for one in (rig, found))
    metres, radians = camera_differences(true, ours)
    return float(metres.max() * 1e3), float(np.rad2deg(radians.max()))


@pytest.fixture(scope="module")
def facing(ring_rig: Callable[..., Rig]) -> Rig:
    """Two cameras that face each other: they never see the same side of a board."""
    return ring_rig(2, radius_m=3.0, height_m=1.0, distortion=(-0.12, 0.05, 0.001, -0.0005, 0.0))


def two_sided(rig: Rig, glued: SE3) -> CornerObservations:
    motion = Waving(seconds=40.0, rate_hz=6.0, centre_m=(0, 0, 1.0), seed=7, reach_m=(0.6, 0.6, 0.4))
    front, back = sides(TWO_SIDED).values()
    return observe_prop(rig, {0: front, 1: back @ glued}, TWO_SIDED, motion, Faults(seed=3))


def test_the_back_of_a_board_links_cameras_that_face_each_other(facing: Rig) -> None:
    seen = two_sided(facing, SE3.identity())
    for target, views, linked in (
        (TWO_SIDED, seen, 2),
        (replace(TWO_SIDED, thickness_m=None), seen.of_patches([0]), 1),
    ):
        key = key_snapshots(views, replace(OPTIONS, time_steps=20), np.zeros((2, 2)))
        assert len(link(facing.cameras, target, key).placed if len(key.camera) else [0]) == linked


@pytest.mark.slow
def test_a_back_that_is_glued_on_badly_does_no_harm(facing: Rig) -> None:
    """It is glued on 3 mm and 0.5 deg beside where its thickness says, which the solve finds out."""
    glued = SE3.from_rotvec(np.deg2rad([0.0, 0.2, 0.5]), np.array([0.003, -0.001, 0.002]))
    seen = two_sided(facing, glued)
    found = calibrate_extrinsics(seen, facing.cameras, TWO_SIDED, OPTIONS)
    millimetres, degrees = worst_mm_and_deg(facing, found.rig)
    assert millimetres < 5
    assert degrees < 0.06
    off = sides(TWO_SIDED)[1].inverse() @ found.prop_from_patch[0].inverse() @ found.prop_from_patch[1]
    np.testing.assert_allclose(off.xyz, glued.xyz, atol=1.5e-3)


def test_the_sides_of_a_board_are_distinguished_by_their_markers() -> None:
    target = TWO_SIDED
    found = [detected(target, drawn(sheet)) for sheet in board_sheets(target, "a0")]
    assert [set(one.patch.tolist()) for one in found] == [{0}, {1}]
    np.testing.assert_array_equal(found[0].corner, found[1].corner)
    assert sorted(set(found[0].corner.tolist())) == list(range(len(target.corners(0))))
    # behind the same place of the board there is the same place seen from behind
    front, back = (sides(target)[side] @ target.corners(side) for side in (0, 1))
    assert front[:, 0].mean() == pytest.approx(back[:, 0].mean())
    np.testing.assert_allclose(front[:, 1], back[:, 1])
    np.testing.assert_allclose(back[:, 2], -(target.thickness_m or 0))


def test_an_inverted_board_has_its_corners_where_the_usual_one_has_them() -> None:
    target = Charuco(columns=5, rows=7, square_m=0.12, marker_m=0.09)
    inverted = replace(target, inverted=True)
    (grey,) = (drawn(sheet) for sheet in board_sheets(target, "a0"))
    usual, other = detected(target, grey), detected(inverted, 255 - grey)
    np.testing.assert_array_equal(usual.corner, other.corner)
    np.testing.assert_allclose(usual.xy_img, other.xy_img, atol=0.05)
    printed = detected(inverted, drawn(board_sheets(inverted, "a0")[0]))
    assert len(printed.xy_img) == len(usual.xy_img)
    shift = printed.xy_img - usual.xy_img
    np.testing.assert_allclose(shift, np.broadcast_to(shift.mean(axis=0), shift.shape), atol=0.6)
    assert len(detected(inverted, grey).xy_img) == 0


def test_a_back_that_cannot_be_is_refused() -> None:
    with pytest.raises(ConfigError, match="DICT_4X4_50 has markers 0 to 49, this target needs 0 to 69; take a larger dictionary"):
        Charuco(columns=7, rows=10, square_m=0.05, marker_m=0.03, thickness_m=0.005)
    with pytest.raises(ConfigError, match="thickness_mm: only a charuco has a back side"):
        described_target(
            TargetDescription(kind="markers", marker_mm=100.0, thickness_mm=3.0), lambda names: ConfigError(str(names))
        )


def detected(target: Charuco, grey: np.ndarray) -> Corners:
    """By the number of the corner: OpenCV finds markers in any order."""
    found = TargetDetector(target).detect(grey)
    order = np.argsort(found.corner, kind="stable")
    return Corners(found.patch[order], found.corner[order], found.xy_img[order])


def drawn(sheet: Sheet, px_per_m: float = 800.0) -> np.ndarray:
    """A page as an image, white where nothing is printed."""
    width, height = (round(side * px_per_m) for side in sheet.size_m)
    scale = 8
    page = np.full((height * scale // 4, width * scale // 4), 255, np.uint8)
    for x, y, w, h in np.array(sheet.black_m) * px_per_m * scale / 4:
        page[round(len(page) - y - h) : round(len(page) - y), round(x) : round(x + w)] = 0
    return cv2.resize(page, (width, height), interpolation=cv2.INTER_AREA)
