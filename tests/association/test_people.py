from dataclasses import replace

import built
import numpy as np
import pytest
from built import standing
from checks import refusal

from posefuse.association import AssociateSettings, assign, associate
from posefuse.association.candidates import (
    agreement,
    candidates_from_detections,
    joint_points,
    pair_midpoints,
    refined_members,
)
from posefuse.core import SKELETONS, Detections2D, Rig, ShapeError
from posefuse.core.depth import keypoint_depth
from posefuse.core.skeleton import COCO17
from posefuse.fusion import FuseSettings, fuse

COCO = SKELETONS["coco17"]
PLACES = {"here": (0.0, 0.0), "beside": (0.3, 1.3), "far": (-1.6, -0.9)}


@pytest.fixture(scope="session")
def body() -> np.ndarray:
    """(17, 3) keypoints of roughly a person's size and shape."""
    rng = np.random.default_rng(3)
    return rng.normal(size=(17, 3)) * [0.15, 0.2, 0.1] + np.linspace(1.6, 0.1, 17)[:, None] * [0, 0, 1]


def crowd(body: np.ndarray, *names: str) -> np.ndarray:
    return np.stack([body + [*PLACES[name], 0] for name in names])


def detections(rig: Rig, people: np.ndarray, noise_px: float = 2.0, seed: int = 0, t_ns: int = 0) -> tuple[list, list]:
    """What each camera reports, people in its own order, and which person is which in it."""
    rng = np.random.default_rng(seed)
    reports, order = [], []
    for camera in rig:
        who = rng.permutation(len(people))
        xy = camera.project(people[who]) + rng.normal(size=(len(people), 17, 2)) * noise_px
        reports.append(built.detections(camera.name, xy, t_ns, score=0.8, sigma_px=2.0 + 0.01 * who[:, None]))
        order.append(who)
    return reports, order


def hide(reports: list[Detections2D], order: list[np.ndarray], person: int, *cameras: int) -> None:
    """These cameras do not report the person."""
    for c in cameras:
        reports[c] = reports[c].people(np.flatnonzero(order[c] != person))


def assert_is(views, row: int, reports, order, person: int, cameras=None):
    for c in range(len(reports)) if cameras is None else cameras:
        place = int(np.flatnonzero(order[c] == person)[0])
        np.testing.assert_array_equal(views.xy_img[row, c], reports[c].xy_img[place])
        np.testing.assert_array_equal(views.sigma_px[row, c], reports[c].sigma_px[place])


def test_rays_of_a_pair_are_as_far_apart_as_least_squares_finds(ring_rig, body):
    """Numpy solves for the two ends: where along both rays they are nearest to each other."""
    found = candidates_from_detections(detections(ring_rig(3), crowd(body, "here"), noise_px=20)[0], ring_rig(3))
    middle, gap = pair_midpoints(found, np.array([[0, 2]]))
    for k in range(17):
        along = np.stack([found.direction[0, k], -found.direction[2, k]], axis=1)
        base = found.centre[2] - found.centre[0]
        (s, t), (square,), *_ = np.linalg.lstsq(along, base, rcond=None)
        assert gap[0, k] == pytest.approx(np.sqrt(square), rel=1e-9)
        ends = found.centre[0] + s * found.direction[0, k], found.centre[2] + t * found.direction[2, k]
        np.testing.assert_allclose(middle[0, k], np.mean(ends, axis=0), atol=1e-9)


def test_two_detections_of_a_person_find_those_of_the_other_cameras(ring_rig, body):
    rig = ring_rig(4)
    found = candidates_from_detections(detections(rig, crowd(body, "here"))[0], rig)
    settings = AssociateSettings()
    for first, free, members in (([0, 2], [0, 1, 2, 3], [0, 1, 2, 3]), ([0, 2], [0, 1, 2], [0, 1, 2]), ([1], [0, 1, 2, 3], [1])):
        refined, pose = refined_members(found, np.array(first), np.isin(found.camera, free), settings)
        assert refined.tolist() == members
        np.testing.assert_array_equal(pose, joint_points(found, refined, settings.tolerance_m))


def test_the_share_that_agrees_is_of_the_keypoints_that_both_know(ring_rig, body):
    rng, rig, pose = np.random.default_rng(5), ring_rig(4), crowd(body, "here")
    reports, _ = detections(rig, pose, noise_px=0.0)
    seen, wrong, known = rng.random((4, 17)) < 0.7, rng.random((4, 17)) < 0.4, rng.random(17) < 0.8
    for c, report in enumerate(reports):
        xy = report.xy_img + np.where(wrong[c], 400.0, 0.0)[:, None]
        reports[c] = built.detections(report.camera, xy, score=np.where(seen[c], 0.8, 0.0)[None])
    share = agreement(candidates_from_detections(reports, rig), np.where(known[:, None], pose, np.nan), 0.1)[1]
    expected = (seen & known & ~wrong).sum(axis=1) / (seen & known).sum(axis=1)
    np.testing.assert_array_equal(share[0], expected)


@pytest.mark.parametrize(("agreeing", "belongs"), [(6, False), (7, True)])
def test_a_detection_belongs_to_a_person_where_enough_of_its_keypoints_agree(ring_rig, body, agreeing, belongs):
    """Of 17 keypoints a share of 0.4 is seven, also of the only detection of a camera."""
    rig = ring_rig(4)
    reports, _ = detections(rig, crowd(body, "here"), noise_px=0.0)
    reports[3] = replace(reports[3], xy_img=reports[3].xy_img + np.where(np.arange(17) < agreeing, 0.0, 300.0)[:, None])
    found = candidates_from_detections(reports, rig)
    members, _ = refined_members(found, np.arange(3), np.ones(4, np.bool_), AssociateSettings())
    assert (3 in members) == belongs


def test_one_who_stands_near_where_a_person_is_expected_is_not_that_person(ring_rig, body):
    """The other views show where the person is: 0.1 m below the expected place, and the bystander is 0.1 m above it."""
    rig = ring_rig(4)
    person = crowd(body, "here")
    reports, _ = detections(rig, person)
    reports[3] = detections(rig, person + [0, 0, 0.2])[0][3]
    found = assign(reports, rig, AssociateSettings(), 0, built.pose(person + [0, 0, 0.1], [0]))
    assert found.place.tolist() == [[0, 0, 0, -1]]


@pytest.mark.parametrize("followed", [0, 1, 2])
def test_the_one_already_followed_among_bystanders(ring_rig, body, followed):
    rig = ring_rig(5)
    people = crowd(body, "here", "beside", "far")
    reports, order = detections(rig, people, t_ns=20_000_000)
    views = associate(reports, rig, AssociateSettings(), built.pose(people[followed : followed + 1] + 0.03, [0]))
    assert views.person_id.tolist() == [0]
    assert_is(views, 0, reports, order, followed)


@pytest.mark.parametrize("name", PLACES)
def test_the_one_at_a_place(ring_rig, body, name):
    rig = ring_rig(8)
    reports, order = detections(rig, crowd(body, *PLACES))
    views = associate(reports, rig, AssociateSettings(near_xy_m=PLACES[name]))
    assert_is(views, 0, reports, order, list(PLACES).index(name))


@pytest.mark.parametrize("name", ["here", "far"])
def test_the_one_at_a_place_with_two_cameras(ring_rig, body, name):
    """Two views propose each person once: the second-best proposal is another person, or none at all."""
    rig = ring_rig(3)
    reports, order = detections(rig, crowd(body, "here", "far"), noise_px=0.5)
    reports[2] = Detections2D.empty(reports[2].camera, 0, COCO)
    settings = AssociateSettings(near_xy_m=PLACES[name], plausible_share=0.0)
    assert_is(associate(reports, rig, settings), 0, reports, order, ["here", "far"].index(name), [0, 1])


def test_the_one_most_views_agree_on(ring_rig, body):
    rig = ring_rig(5)
    reports, order = detections(rig, crowd(body, "here", "beside"))
    hide(reports, order, 0, 0, 3)
    assert_is(associate(reports, rig, AssociateSettings()), 0, reports, order, 1, [1, 2, 4])


def test_every_person_gets_their_own_views_and_keeps_their_id(ring_rig, body):
    rig = ring_rig(5)
    people = crowd(body, *PLACES)
    settings = AssociateSettings(max_people=4)
    previous, names = None, {}
    for step in range(4):
        moved = people + step * np.array([0.03, -0.02, 0.0])
        reports, order = detections(rig, moved, seed=step, t_ns=step * 33_000_000)
        views = associate(reports, rig, settings, previous)
        assert views.person_id.tolist() == [0, 1, 2]
        for row in range(3):
            place = int(np.argmin(np.abs(reports[0].xy_img - views.xy_img[row, 0]).sum(axis=(1, 2))))
            who = int(order[0][place])
            assert names.setdefault(row, who) == who
            assert_is(views, row, reports, order, who)
        previous = built.pose(moved[[names[row] for row in range(3)]], [0, 1, 2], step * 33_000_000)
    assert sorted(names.values()) == [0, 1, 2]


def test_a_camera_that_lost_the_person_gives_nothing(ring_rig, body):
    rig = ring_rig(4)
    reports, order = detections(rig, crowd(body, "here", "far"))
    hide(reports, order, 0, 2)
    views = associate(reports, rig, AssociateSettings(near_xy_m=PLACES["here"]))
    assert np.isnan(views.xy_img[0, 2]).all()
    assert (views.score[0, 2] == 0).all()
    assert_is(views, 0, reports, order, 0, [0, 1, 3])


def test_a_bystander_does_not_take_the_place_of_one_out_of_sight(ring_rig, body):
    rig = ring_rig(4)
    people = crowd(body, "here", "far")
    reports, _ = detections(rig, people[1:], t_ns=100_000_000)
    settings = AssociateSettings(lost_after_s=1.0)
    before = built.pose(people[:1], [0])
    assert associate(reports, rig, settings, before).person_id.tolist() == []
    later, _ = detections(rig, people[1:], t_ns=1_100_000_000)
    assert associate(later, rig, settings, before).person_id.tolist() == [0]


def test_followed_by_a_single_camera(ring_rig, body):
    rig = ring_rig(3)
    people = crowd(body, "here")
    reports, order = detections(rig, people)
    hide(reports, order, 0, 0, 2)
    assert associate(reports, rig, AssociateSettings()).person_id.tolist() == []
    views = associate(reports, rig, AssociateSettings(), built.pose(people, [0]))
    assert_is(views, 0, reports, order, 0, [1])
    assert np.isnan(views.xy_img[0, [0, 2]]).all()


def test_a_view_with_sides_swapped_still_is_the_person(ring_rig, body):
    rig = ring_rig(4)
    reports, _ = detections(rig, crowd(body, "here"))
    reports[1] = replace(reports[1], xy_img=reports[1].xy_img[:, COCO.mirror])
    views = associate(reports, rig, AssociateSettings())
    np.testing.assert_array_equal(views.xy_img[0, 1], reports[1].xy_img[0])


def test_nan_and_zero_scores_count_for_nothing(ring_rig, body):
    rig = ring_rig(3)
    reports, _ = detections(rig, crowd(body, "here"))
    reports[0] = built.detections("cam00", np.full((1, 17, 2), np.nan), score=np.nan, sigma_px=np.nan)
    unseen, *seen = associate(reports, rig, AssociateSettings()).xy_img[0]
    assert np.isnan(unseen).all() and np.isfinite(seen).all()


def test_cameras_in_another_order_are_refused(ring_rig, body):
    rig = ring_rig(3)
    reports, _ = detections(rig, crowd(body, "here"))
    refusal(ShapeError, "in this order, got cam02, cam01, cam00", lambda: associate(reports[::-1], rig, AssociateSettings()))


@pytest.mark.parametrize("seed", [4, 11])
def test_every_view_of_noisy_people_is_found_as_choices_are_settled_twice(ring_rig, body, seed):
    """With 16 px of noise the first answer of a pair of views leaves out views that the fused answer of all others explains."""
    rig = ring_rig(6)
    reports, order = detections(rig, crowd(body, "here", "beside"), noise_px=16.0, seed=seed)
    views = associate(reports, rig, AssociateSettings(max_people=2))
    first = int(order[0][np.argmin(np.abs(reports[0].xy_img - views.xy_img[0, 0]).sum(axis=(1, 2)))])
    assert_is(views, 0, reports, order, first)
    assert_is(views, 1, reports, order, 1 - first)


def test_two_views_that_meet_in_no_human_body_make_no_person(ring_rig, body):
    rig = ring_rig(3)
    giant, child = body * 3, body * 0.6
    for people, count in ((giant, 0), (child, 1)):
        reports, order = detections(rig, people[None])
        hide(reports, order, 0, 2)
        assert len(associate(reports, rig, AssociateSettings()).person_id) == count, "two views alone"
    reports, _ = detections(rig, giant[None])
    assert len(associate(reports, rig, AssociateSettings()).person_id) == 1, "three views agree: it is there"


def test_only_detections_whose_rays_meet_propose_a_person(ring_rig, body, monkeypatch):
    """The work is counted: how well proposals agree with all detections is what takes the time."""
    proposed = []

    def counted(candidates, poses, tolerance_m):
        proposed.append(len(poses))
        return agreement(candidates, poses, tolerance_m)

    monkeypatch.setattr("posefuse.association.people.agreement", counted)
    reports, _ = detections(ring_rig(4), crowd(body, *PLACES))
    views = associate(reports, ring_rig(4), AssociateSettings(max_people=3))
    # three people in four cameras are 18 pairs of one person, and 36 of two
    assert len(views.person_id) == 3 and 18 <= max(proposed) <= 27


def test_with_a_person_end_all_proposals_of_that_person(ring_rig, body, monkeypatch):
    """The work is counted: each of three people is settled once, and no proposal is left for a fourth."""
    settled = []

    def counted(*args):
        settled.append(args)
        return refined_members(*args)

    monkeypatch.setattr("posefuse.association.people.refined_members", counted)
    reports, _ = detections(ring_rig(4), crowd(body, *PLACES))
    views = associate(reports, ring_rig(4), AssociateSettings(max_people=4))
    assert len(views.person_id) == len(settled) == 3


# --- a detection with depth proposes a person by itself; anything that is no human body does not become one


def seen(camera, *people: np.ndarray, depth: bool = True, deeper: float = 1.0) -> Detections2D:
    """Exact px of people and the depth of the surface in front of them, which is `deeper` times what it should be."""
    xyz = np.array(people)
    in_camera = camera.cam_from_world @ xyz
    norm = in_camera[..., :2] / in_camera[..., 2:]
    below = keypoint_depth(np.zeros(norm.shape), norm, COCO17)[..., 0]
    surface = np.stack([in_camera[..., 2] * deeper - below, np.full(below.shape, 0.02)], axis=-1)
    return built.detections(camera.name, camera.project(xyz), depth_m=surface if depth else None)


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
    """Without depth one view fits a person at any distance; with it a person of another size behind them does not."""
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
