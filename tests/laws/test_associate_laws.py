import numpy as np
import pytest
from built import detections

from posefuse.association import AssociateSettings, associate
from posefuse.core import SE3, Rig


@pytest.fixture
def scene(ring_rig):
    """Four cameras, three people, each camera lacking some and listing them in its own order."""
    rig = ring_rig(4, distortion=(-0.2, 0.05, 0.001, -0.002))
    rng = np.random.default_rng(0)
    upright = np.linspace(1.6, 0.1, 17)[:, None] * [0, 0, 1]
    places = ((0, 0, 0), (0.4, 1.2, 0), (-1.4, -0.8, 0))
    people = np.stack([rng.normal(size=(17, 3)) * [0.15, 0.2, 0.1] + upright + place for place in places])
    reports = []
    for camera in rig:
        who = rng.permutation(3)[: 2 + rng.integers(2)]
        xy = camera.project(people[who]) + rng.normal(size=(len(who), 17, 2)) * 3
        score = rng.uniform(0.3, 1.0, xy.shape[:2])
        reports.append(detections(camera.name, xy, score=score))
    return rig, reports


@pytest.mark.parametrize("people", [1, 3])
def test_moving_the_world_changes_no_person(scene, people):
    rig, reports = scene
    settings = AssociateSettings(max_people=people)
    moved = rig.moved(SE3.from_rotvec([0.3, -1.1, 2.0], [5.0, -3.0, 0.7]))
    here, there = associate(reports, rig, settings), associate(reports, moved, settings)
    assert len(here.person_id) == people
    np.testing.assert_array_equal(there.xy_img, here.xy_img)


@pytest.mark.parametrize("people", [1, 3])
def test_the_order_of_cameras_changes_no_person(scene, people):
    rig, reports = scene
    settings = AssociateSettings(max_people=people)
    order = [2, 0, 3, 1]
    here = associate(reports, rig, settings)
    there = associate([reports[i] for i in order], Rig(tuple(rig.cameras[i] for i in order)), settings)
    np.testing.assert_array_equal(there.xy_img, here.xy_img[:, order])


def test_the_order_within_a_camera_changes_no_person(scene):
    rig, reports = scene
    turned = [d.people(np.arange(len(d))[::-1]) for d in reports]
    settings = AssociateSettings(max_people=3)
    np.testing.assert_array_equal(associate(turned, rig, settings).xy_img, associate(reports, rig, settings).xy_img)
