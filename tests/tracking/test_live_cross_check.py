"""What began with wrong views is corrected by the cameras that agree: keypoints, and left and right."""

from dataclasses import replace

import numpy as np
import pytest
from built import without

from posefuse.core.skeleton import COCO17
from posefuse.tracking.online import LiveSettings
from posefuse.tracking.online.cross_check import CrossCheck
from posefuse.tracking.online.person import Model

WRIST = COCO17.index("left_wrist")
ARMS = [COCO17.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("shoulder", "elbow", "wrist")]
BEGIN_S, END_S = 0.6, 2.2
WRONG_PX = np.array([60.0, 35.0])


def errors_of(w, changed, keypoints):
    """Largest error of some keypoints by time in s, for views as `changed` makes them."""
    tracker, errors = w.tracker(), {}
    for view in w.views(END_S):
        tracker.add(changed(view))
        pose = tracker.at(view.t_ns)
        if len(pose.person_id):
            errors[view.t_ns * 1e-9] = w.error_m(pose)[keypoints].max()
    return errors


def test_cameras_that_agree_correct_a_keypoint_that_began_with_a_wrong_view(world):
    """The first camera takes something else for the wrist throughout; two others see the wrist after `BEGIN_S` only."""
    w = world(cameras=4, motion="stand")
    first, _, *others = w.rig.names

    def changed(view):
        hidden = view.camera in others and view.t_ns < BEGIN_S * 1e9
        return wrong_wrist(view) if view.camera == first else without(view, [WRIST]) if hidden else view

    errors = errors_of(w, changed, [WRIST])
    before = [error for t_s, error in errors.items() if 0.3 < t_s < BEGIN_S]
    after = [error for t_s, error in errors.items() if t_s > BEGIN_S + 0.7]
    assert np.min(before) > 0.2, "the scene is hard enough: the wrong view counted"
    assert np.median(after) < 0.05
    assert np.isfinite(after).all()


def test_arms_that_began_exchanged_are_put_right(world):
    """Two cameras exchange the arms for good; the others see none until `BEGIN_S`, so that the person begins exchanged."""
    w = world(cameras=5, motion="stand")
    wrong = w.rig.names[:2]

    def changed(view):
        hidden = view.t_ns < BEGIN_S * 1e9
        return exchanged(view, ARMS) if view.camera in wrong else without(view, ARMS) if hidden else view

    errors = errors_of(w, changed, ARMS)
    assert np.max([error for t_s, error in errors.items() if t_s < BEGIN_S]) > 0.2, "the scene is hard enough"
    after = [error for t_s, error in errors.items() if t_s > BEGIN_S + 1.0]
    assert np.isfinite(after).all()
    assert np.median(after) < 0.05


def test_a_hidden_wrist_does_not_stay_with_the_other_one(world):
    """From `BEGIN_S` on one camera puts the left wrist where the right one is, and no other sees it."""
    w = world(cameras=4, motion="stand")

    def changed(view):
        if view.t_ns <= BEGIN_S * 1e9:
            return view
        return exchanged(view, [WRIST]) if view.camera == w.rig.names[0] else without(view, [WRIST])

    errors = errors_of(w, changed, [WRIST])
    # once it is lost (`LiveSettings.lost_after_s`) it does not begin again there
    after = [error for t_s, error in errors.items() if t_s > BEGIN_S + 1.0]
    assert not any(error > 0.2 for error in after)


@pytest.mark.parametrize(("between_outputs", "with_views"), [(True, False), (False, True)])
def test_a_check_is_done_between_outputs_or_else_with_the_next_view(world, monkeypatch, between_outputs, with_views):
    w = world(cameras=4, motion="stand")
    tracker, now, checks = w.tracker(), "", []
    real = CrossCheck.check

    def noted(self, person, t_ns):
        checks.append((now, t_ns))
        real(self, person, t_ns)

    monkeypatch.setattr(CrossCheck, "check", noted)
    for view in w.views(END_S):
        now = "view"
        tracker.add(view)
        tracker.at(view.t_ns)
        now = "between outputs"
        if between_outputs:
            tracker.check()
    assert {when for when, _ in checks} == {"view"} if with_views else {"between outputs"}
    # as often either way
    assert np.diff([t_ns for _, t_ns in checks]).min() >= 200_000_000
    assert len(checks) >= END_S / 0.25


class Tracked:
    """Someone who is tracked at (K, 3) in the world, whatever a check says; what each check said is kept."""

    def __init__(self, xyz):
        self.xyz, self.exchanged, self.began_again = xyz, [], []

    def expected(self, t_ns):
        return self.xyz, np.full(len(self.xyz), 0.01)

    def exchange(self, groups):
        self.exchanged.append(bool(groups.any()))

    def begin_again(self, xyz):
        self.began_again.append(bool(np.isfinite(xyz).any()))


def checked(world, xyz, steps):
    """`Tracked` at xyz after checks 0.2 s apart: in a step ``all`` cameras see the true body, ``two`` do, or an ``other`` one."""
    standing = world(motion="stand").place(0.0)
    w = world(cameras=4, motion=lambda t_s: standing + (1.0 if steps[round(t_s / 0.2)] == "other" else 0.0))
    check, person = CrossCheck(Model(w.rig, COCO17, LiveSettings()), w.fuse), Tracked(xyz)
    for n, step in enumerate(steps):
        for c in range(2 if step == "two" else 4):
            check.keep(w.view(c, 0.2 * n))
        check.check(person, round(0.2 * n * 1e9))
    return person


@pytest.mark.parametrize("nothing", ["two", "other"])
def test_arms_are_exchanged_after_three_checks_running_and_a_check_that_found_nothing_ends_a_run(world, nothing):
    arms_exchanged = world(motion="stand").place(0.0)
    arms_exchanged[ARMS] = arms_exchanged[np.array(COCO17.mirror)[ARMS]]
    assert checked(world, arms_exchanged, ["all"] * 3).exchanged == [False, False, True]
    # a check that judges nothing changes nothing in the person
    interrupted = checked(world, arms_exchanged, ["all", "all", nothing, "all", "all", "all"])
    assert interrupted.exchanged == [False, False, False, False, True]


@pytest.mark.parametrize("nothing", ["two", "other"])
def test_a_wrist_begins_elsewhere_after_two_checks_running_and_a_check_that_found_nothing_ends_a_run(world, nothing):
    off = world(motion="stand").place(0.0)
    off[WRIST, 2] += 0.3
    assert checked(world, off, ["all"] * 2).began_again == [False, True]
    assert checked(world, off, ["all", nothing, "all", "all"]).began_again == [False, False, True]


def exchanged(view, keypoints):
    xy, mirror = view.xy_img.copy(), np.array(COCO17.mirror)
    xy[:, keypoints] = view.xy_img[:, mirror[keypoints]]
    return replace(view, xy_img=xy)


def wrong_wrist(view):
    xy = view.xy_img.copy()
    xy[:, WRIST] += WRONG_PX
    # it says itself that it is not so sure
    sigma = view.sigma_px.copy()
    sigma[:, WRIST] *= 2
    return replace(view, xy_img=xy, sigma_px=sigma)
