"""Too few views: what is not known is let go, and no person runs away along the rays of one camera."""

import numpy as np
import pytest


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
    assert np.nanmedian(w.error_m(tracker.at(3_950_000_000))) < 0.05


@pytest.mark.parametrize(("speed_m_s", "followed"), [(8.0, True), (25.0, False)])
def test_what_is_faster_than_any_runner_is_let_go(world, speed_m_s, followed):
    still = world(motion="stand").place
    w = world(motion=lambda t_s: still(t_s) + (speed_m_s * (t_s - 0.15), 0.0, 0.0))
    tracker = w.tracker()
    for view in w.views(0.3, rate_hz=60.0, seed=None):
        tracker.add(view)
    assert (len(tracker.at(295_000_000).person_id) == 1) == followed
