"""A detection with depth proposes a person by itself; anything that is no human body does not become one."""

from dataclasses import replace

import numpy as np
import pytest

from posefuse.association import AssociateSettings, assign, associate
from posefuse.core import Detections2D
from posefuse.core.depth import keypoint_depth
from posefuse.core.skeleton import COCO17
from posefuse.fusion import FuseSettings, fuse

# the left side of someone who faces +x; y to the left, z up
_LEFT = {
    "eye": (0.10, 0.03, 1.65), "ear": (0.0, 0.08, 1.63), "shoulder": (0.0, 0.19, 1.42), "elbow": (0.03, 0.27, 1.14),
    "wrist": (0.12, 0.28, 0.90), "hip": (0.0, 0.10, 0.93), "knee": (0.03, 0.11, 0.50), "ankle": (0.0, 0.11, 0.09),
}  # fmt: skip


def standing(x: float = 0.0, y: float = 0.0, size: float = 1.0) -> np.ndarray:
    rows = []
    for name in COCO17.keypoints:
        side, _, part = name.partition("_")
        place = (0.12, 0.0, 1.62) if name == "nose" else np.array(_LEFT[part]) * (1, 1 if side == "left" else -1, 1)
        rows.append(np.array(place) * size + [x, y, 0])
    return np.array(rows)


def seen(camera, *people: np.ndarray, depth: bool = True, deeper: float = 1.0) -> Detections2D:
    """Exact px of people and the depth of the surface in front of them, which is `deeper` times what it should be."""
    xyz = np.array(people)
    in_camera = camera.cam_from_world @ xyz
    norm = in_camera[..., :2] / in_camera[..., 2:]
    below = keypoint_depth(np.zeros(norm.shape), norm, COCO17)[..., 0]
    surface = np.stack([in_camera[..., 2] * deeper - below, np.full(below.shape, 0.02)], axis=-1)
    return Detections2D(
        camera=camera.name, t_ns=0, skeleton=COCO17, xy_img=camera.project(xyz), score=np.full(below.shape, 0.9),
        sigma_px=np.full(below.shape, 2.0), box_img=np.zeros((len(xyz), 4)), depth_m=surface if depth else None,
    )  # fmt: skip


def test_one_camera_with_depth_finds_several_people_and_without_it_none(ring_rig) -> None:
    rig, people = ring_rig(1), (standing(), standing(0.4, 0.9))
    settings = AssociateSettings(max_people=2)
    assert not len(associate([seen(rig.cameras[0], *people, depth=False)], rig, settings).person_id)
    views = associate([seen(rig.cameras[0], *people)], rig, settings)
    pose = fuse(views, rig, FuseSettings())
    assert sorted(pose.person_id) == [0, 1]
    found = pose.xyz_world[np.argsort(pose.xyz_world[:, 0, 1])]
    np.testing.assert_allclose(found, np.array(people), atol=1e-5)


@pytest.mark.parametrize("deeper", [0.4, 2.5])
def test_a_picture_of_a_person_is_none(ring_rig, deeper: float) -> None:
    """What has the outline of a person at another depth has not a person's size."""
    rig = ring_rig(1)
    assert not len(associate([seen(rig.cameras[0], standing(), deeper=deeper)], rig, AssociateSettings()).person_id)


def test_two_cameras_agree_before_one_alone_proposes(ring_rig) -> None:
    """A nearer bystander in one view does not take the place of the person whom both views see."""
    rig = ring_rig(2)
    person, bystander = standing(), standing(1.2, 0.8)
    views = [seen(rig.cameras[0], bystander, person), seen(rig.cameras[1], person)]
    found = assign(views, rig, AssociateSettings(), 0)
    np.testing.assert_array_equal(found.place, [[1, 0]])
    both = assign(views, rig, AssociateSettings(max_people=2), 0)
    assert sorted(map(tuple, both.place.tolist())) == [(0, -1), (1, 0)]


def test_a_person_whom_one_camera_follows_is_held_against_its_depth(ring_rig) -> None:
    """Without depth one view fits a person at any distance; with it somebody of another size behind them does not."""
    rig = ring_rig(1)
    camera = rig.cameras[0]
    before = fuse(associate([seen(camera, standing())], rig, AssociateSettings()), rig, FuseSettings())
    eye = camera.centre_world
    behind = eye + 1.6 * (standing() - eye)
    same_outline = seen(camera, behind)
    np.testing.assert_allclose(same_outline.xy_img, seen(camera, standing()).xy_img, atol=1e-3)
    plain = replace(same_outline, depth_m=None)
    assert len(assign([plain], rig, AssociateSettings(), 0, before).person_id) == 1
    assert not len(assign([same_outline], rig, AssociateSettings(), 0, before).person_id)
