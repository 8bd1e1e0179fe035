"""A keypoint that began with a wrong view is corrected by the cameras that agree, and nothing else is."""

from dataclasses import replace

import numpy as np

from posefuse.core.skeleton import COCO17

WRIST = COCO17.index("left_wrist")
BEGIN_S, END_S = 0.6, 2.2
WRONG_PX = np.array([60.0, 35.0])


def test_cameras_that_agree_correct_a_keypoint_that_began_with_a_wrong_view(world):
    """The first camera takes something else for the wrist throughout; two others see the wrist after `BEGIN_S` only."""
    w = world(cameras=4, motion="stand")
    first, _, *others = w.rig.names
    tracker, errors = w.tracker(), {}
    for view in w.views(END_S):
        told = wrong_wrist(view) if view.camera == first else view
        if view.camera in others and view.t_ns < BEGIN_S * 1e9:
            told = without_wrist(told)
        tracker.add(told)
        pose = tracker.at(view.t_ns)
        if len(pose.person_id):
            errors[view.t_ns * 1e-9] = w.error_m(pose)[WRIST]
    before = [error for t_s, error in errors.items() if 0.3 < t_s < BEGIN_S]
    after = [error for t_s, error in errors.items() if t_s > BEGIN_S + 0.7]
    assert np.min(before) > 0.2, "the scene is hard enough: the wrong view counted"
    assert np.median(after) < 0.05
    assert np.isfinite(after).all()


def wrong_wrist(view):
    xy = view.xy_img.copy()
    xy[:, WRIST] += WRONG_PX
    # it says itself that it is not so sure
    sigma = view.sigma_px.copy()
    sigma[:, WRIST] *= 2
    return replace(view, xy_img=xy, sigma_px=sigma)


def without_wrist(view):
    xy, score = view.xy_img.copy(), view.score.copy()
    xy[:, WRIST], score[:, WRIST] = np.nan, 0.0
    return replace(view, xy_img=xy, score=score)
