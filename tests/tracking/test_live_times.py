"""Times as data: order of arrival, replays, clocks that jump, floods."""

from dataclasses import replace

import numpy as np
import pytest
from built import without

from posefuse.core import SE3, Detections2D
from posefuse.core.skeleton import COCO17

HOUR_NS = 3_600_000_000_000


def same(one, two, tolerance=0.0):
    assert one.person_id.tolist() == two.person_id.tolist()
    for name in ("xyz_world", "cov_world", "reproj_px", "n_views", "kind"):
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=0, atol=tolerance, err_msg=name)


def test_asking_changes_nothing(world):
    w = world()
    quiet, asked = w.tracker(), w.tracker()
    for view in w.views(1.0):
        quiet.add(view)
        asked.add(view)
        asked.at(view.t_ns + 30_000_000)
    same(quiet.at(1_050_000_000), asked.at(1_050_000_000))


def test_the_order_of_arrival_does_not_matter_within_the_buffer(world):
    w = world()
    views = w.views(1.5)
    rng = np.random.default_rng(3)
    first = [v for v in views if v.t_ns < 4e8]
    rest = [v for v in views if v.t_ns >= 4e8]
    late = sorted(rest, key=lambda v: v.t_ns + rng.uniform(0, 2e8))
    assert [v.t_ns for v in late] != [v.t_ns for v in rest]
    one, two = (w.fed(order) for order in (first + rest, first + late))
    same(one.at(1_560_000_000), two.at(1_560_000_000), tolerance=1e-9)
    assert all(figures.late == 0 for figures in two.health.values())


def test_views_older_than_the_buffer_are_counted_and_change_nothing(world):
    w = world()
    tracker = w.fed(w.views(1.0))
    before = tracker.at(1_050_000_000)
    tracker.add(replace(w.view(0, 0.40001, np.random.default_rng(1)), camera="cam00"))
    assert tracker.health["cam00"].late == 1
    same(before, tracker.at(1_050_000_000))


def test_moving_the_world_moves_the_people(world):
    w = world()
    turn = SE3(np.array([0.9, 0.1, -0.2, 0.3]) / np.linalg.norm([0.9, 0.1, -0.2, 0.3]), np.array([3.0, -2.0, 0.5]))
    moved = type(w)(w.rig.moved(turn), lambda t_s: turn @ w.place(t_s))
    here, there = (one.fed(w.views(1.2)).at(1_250_000_000) for one in (w, moved))
    np.testing.assert_allclose(turn @ here.xyz_world, there.xyz_world, atol=1e-5)
    rotation = turn.matrix()
    np.testing.assert_allclose(rotation @ here.cov_world @ rotation.T, there.cov_world, atol=1e-6)


def test_a_clock_that_jumps_an_hour_is_ignored_and_named(world):
    w = world()

    def jumped(hours):
        for view in w.views(1.5):
            jumps = view.camera == "cam03" and view.t_ns > 5e8
            if hours or not jumps:
                yield replace(view, t_ns=view.t_ns + jumps * hours * HOUR_NS)

    clean, ahead, back = (w.fed(jumped(hours)) for hours in (0, 1, -1))
    same(ahead.at(1_550_000_000), clean.at(1_550_000_000))
    assert ahead.health["cam03"].age_s > 0.9
    same(back.at(1_550_000_000), clean.at(1_550_000_000))
    assert back.health["cam03"].late == 30


def test_a_first_camera_an_hour_ahead_is_outvoted(world):
    w = world()
    tracker = w.fed(replace(v, t_ns=v.t_ns + HOUR_NS) if v.camera == "cam00" else v for v in w.views(1.0))
    pose = tracker.at(1_000_000_000)
    assert pose.person_id.tolist() == [0]
    assert np.nanmax(w.error_m(pose)) < 0.15
    ages_s = [tracker.health[name].age_s for name in w.rig.names]
    assert np.isnan(ages_s[0]) and (np.array(ages_s[1:]) >= 0).all()


def test_a_common_jump_of_all_cameras_is_a_jump_of_time(world):
    w = world(motion="stand")
    tracker = w.fed([*w.views(0.6), *(replace(view, t_ns=view.t_ns + HOUR_NS) for view in w.views(0.6))])
    pose = tracker.at(HOUR_NS + 650_000_000)
    assert pose.person_id.tolist() == [0]
    assert np.nanmax(np.linalg.norm(pose.xyz_world[0] - w.place(0), axis=-1)) < 0.1


def test_the_same_moment_twice_counts_once(world):
    w = world()
    once, twice = w.fed(w.views(0.8)), w.fed(view for view in w.views(0.8) for _ in range(2))
    same(once.at(850_000_000), twice.at(850_000_000))


def test_a_flood_is_refused_and_memory_stays_bounded(world):
    w = world()
    flood = [w.view(1, 0.8 + i * 1e-5) for i in range(3000)]
    # one in 4 ms
    flooded, thinned = (w.fed([*w.views(0.8), *views]) for views in (flood, flood[::400]))
    same(flooded.at(840_000_000), thinned.at(840_000_000))


def test_no_person_and_nothing_finite_are_no_one(world, detections_of):
    w = world()
    tracker = w.tracker()
    assert len(tracker.at(0).person_id) == 0
    for i, camera in enumerate(w.rig.names):
        tracker.add(Detections2D.empty(camera, i * 1_000_000, COCO17))
        blank = detections_of(camera, 0.05 + i * 1e-3, np.full((17, 2), np.nan))
        tracker.add(replace(blank, sigma_px=np.full((1, 17), np.nan)))
    assert len(tracker.at(100_000_000).person_id) == 0


def test_missing_keypoints_are_missing_and_come_when_they_are_seen(world):
    w = world(motion="stand")
    wrist = COCO17.index("left_wrist")
    tracker = w.tracker()
    for view in w.views(1.6):
        if view.t_ns < 8e8:
            view = without(view, [wrist])
        elif view.t_ns < 8.4e8:
            assert np.isnan(tracker.at(790_000_000).xyz_world[0, wrist]).all()
        tracker.add(view)
    assert w.error_m(tracker.at(1_600_000_000))[wrist] < 0.05


def test_a_view_without_stated_noise_is_used(world):
    w = world(motion="stand")
    tracker = w.fed(replace(view, sigma_px=np.full((1, len(COCO17)), np.nan)) for view in w.views(1.0))
    assert np.nanmax(w.error_m(tracker.at(1_000_000_000))) < 0.1


def test_a_rolling_shutter_is_known(world):
    stand = world(motion="stand").place(0)
    w = world(motion=lambda t_s: stand + np.array([0.0, 2.0, 0.0]) * (t_s - 0.7))
    rolling = type(w)(replace(w.rig, cameras=tuple(replace(camera, readout_s=0.03) for camera in w.rig)), w.place)
    errors = {}
    for name, rig in (("known", rolling), ("unknown", w)):
        tracker = rig.fed(_rolled(w, view, 0.03) for view in w.views(1.4, seed=None))
        errors[name] = np.nanmean(w.error_m(tracker.at(1_400_000_000)))
    assert errors["known"] < 0.4 * errors["unknown"]


def _rolled(w, view, readout_s):
    """The view with every keypoint where it is when its row is exposed."""
    camera = w.rig[view.camera]
    xy = view.xy_img[0].astype(float)
    for _ in range(4):
        after_s = readout_s * (xy[:, 1] / (camera.size_wh[1] - 1) - 0.5)
        xy = np.array([camera.project(w.place(view.t_ns / 1e9 + after)[i]) for i, after in enumerate(after_s)])
    return replace(view, xy_img=xy[None])


# --- too few views: what is not known is let go, and no person runs away along the rays of one camera


def test_whom_one_camera_alone_sees_is_let_go_in_time_and_found_again(world):
    w = world(motion="stand")
    tracker, here = w.tracker(alone_s=1.0), {}
    for view in (view for view in w.views(4.0) if view.camera == "cam00" or not 1e9 < view.t_ns < 3e9):
        tracker.add(view)
        here[view.t_ns / 1e9] = len(tracker.at(view.t_ns).person_id)
    times, people = np.array(list(here)), np.array(list(here.values()))
    assert (people[(times > 0.3) & (times < 1.95)] == 1).all()
    assert (people[(times > 2.05) & (times < 3.0)] == 0).all()
    assert (people[times > 3.2] == 1).all()
    back = tracker.at(3_950_000_000)
    assert back.person_id.tolist() == [0] and np.nanmedian(w.error_m(back)) < 0.05


@pytest.mark.parametrize(("speed_m_s", "followed"), [(8.0, True), (25.0, False)])
def test_what_is_faster_than_any_runner_is_let_go(world, speed_m_s, followed):
    still = world(motion="stand").place
    w = world(motion=lambda t_s: still(t_s) + (speed_m_s * (t_s - 0.15), 0.0, 0.0))
    tracker = w.fed(w.views(0.3, rate_hz=60.0, seed=None))
    assert (len(tracker.at(295_000_000).person_id) == 1) == followed
