"""A detection with depth proposes a person by itself; anything that is no human body does not become one."""

from dataclasses import replace

import numpy as np
import pytest
from built import detections, standing

from posefuse.association import AssociateSettings, assign, associate
from posefuse.core import Detections2D
from posefuse.core.depth import keypoint_depth
from posefuse.core.skeleton import COCO17
from posefuse.fusion import FuseSettings, fuse


def seen(camera, *people: np.ndarray, depth: bool = True, deeper: float = 1.0) -> Detections2D:
    """Exact px of people and the depth of the surface in front of them, which is `deeper` times what it should be."""
    xyz = np.array(people)
    in_camera = camera.cam_from_world @ xyz
    norm = in_camera[..., :2] / in_camera[..., 2:]
    below = keypoint_depth(np.zeros(norm.shape), norm, COCO17)[..., 0]
    surface = np.stack([in_camera[..., 2] * deeper - below, np.full(below.shape, 0.02)], axis=-1)
    return detections(camera.name, camera.project(xyz), depth_m=surface if depth else None)


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
