"""The oracle errs exactly as its settings state, whatever order it is asked in."""

import numpy as np
import pytest
from built import frame
from checks import refusal

from posefuse.core import SKELETONS, CameraTruth, Detector, InputError, Region, Truth
from posefuse_sim.oracle import OracleDetector, OracleNoise, oracle_views

BODY = SKELETONS["anatomical23"]
FRAMES, PEOPLE = 7, 2


@pytest.fixture(scope="module")
def truth(ring_rig) -> Truth:
    rig = ring_rig(3)
    rng = np.random.default_rng(1)
    t_ns = np.arange(FRAMES) * 33_000_000
    body = rng.uniform([-0.3, -0.3, 0.2], [0.3, 0.3, 1.7], (len(BODY), 3))
    xyz = body + np.array([[-1.2, 0, 0], [1.2, 0.3, 0]])[:, None] + rng.normal(0, 0.02, (FRAMES, 1, 1, 3))
    visible = rng.random((len(rig), FRAMES, PEOPLE, len(BODY))) < 0.8
    seen = zip(rig, visible, strict=True)
    views = tuple(CameraTruth(camera=one.name, t_ns=t_ns, xy_img=one.project(xyz), visible=there) for one, there in seen)
    return Truth(rig=rig, t_ns=t_ns, skeleton=BODY, person_id=np.arange(PEOPLE), xyz_world=xyz, views=views)


def test_it_is_a_detector_and_errs_by_its_sigma(truth):
    oracle = OracleDetector(truth, OracleNoise(sigma_px=2.0), seed=5)
    assert isinstance(oracle, Detector) and oracle.skeleton is BODY
    views = oracle_views(truth, OracleNoise(sigma_px=2.0), seed=5)
    exact = np.stack([view.xy_img for view in truth.views], axis=2)
    ratio = (views.xy_img - exact) / views.sigma_px[..., None]
    assert (ratio**2).mean() == pytest.approx(1.0, abs=0.15)
    hidden = ~np.stack([view.visible for view in truth.views], axis=2)
    assert np.allclose(views.sigma_px[hidden], 8.0) and np.allclose(views.sigma_px[~hidden], 2.0)
    assert views.score[hidden].max() < views.score[~hidden].min()


def test_one_question_and_all_at_once_agree_in_any_order(truth):
    noise = OracleNoise(outlier_share=0.2, swap_share=0.3, bias_px=3.0)
    oracle = OracleDetector(truth, noise, seed=9)
    views = oracle_views(truth, noise, seed=9)
    for i in (5, 0, 3):
        for c in (2, 0, 1):
            (seen,) = oracle.detect([frame(truth.rig.names[c], int(truth.t_ns[i]))], [None])
            assert np.allclose(seen.xy_img, views.xy_img[i, :, c], atol=1e-3)
            assert np.allclose(seen.score, views.score[i, :, c])
    other = oracle_views(truth, noise, seed=10)
    assert not np.allclose(other.xy_img, views.xy_img, equal_nan=True)


def test_swaps_are_of_sides_and_outliers_are_far_and_sure_of_themselves(truth):
    exact = np.stack([view.xy_img for view in truth.views], axis=2)
    swapped = oracle_views(truth, OracleNoise(sigma_px=0.01, swap_share=1.0), seed=1)
    assert np.allclose(swapped.xy_img, exact[..., BODY.mirror, :], atol=0.3)
    wild = oracle_views(truth, OracleNoise(sigma_px=0.01, outlier_share=0.5), seed=1)
    away = np.linalg.norm(wild.xy_img - exact, axis=-1)
    assert (away > 5).mean() == pytest.approx(0.5, abs=0.06)
    assert wild.score[away > 5].max() > 0.8


def test_missed_people_are_left_out_or_nan(truth):
    oracle = OracleDetector(truth, OracleNoise(miss_share=1.0))
    camera, t_ns = truth.rig.names[1], int(truth.t_ns[2])
    found, asked = oracle.detect([frame(camera, t_ns)] * 2, [None, [Region(centre_img=np.array([320.0, 240.0]), side_px=4000.0)]])
    assert len(found) == 0
    assert len(asked) == 1 and np.isnan(asked.xy_img).all() and not asked.score.any()


def test_a_region_asks_for_the_person_in_it(truth):
    oracle = OracleDetector(truth, OracleNoise(sigma_px=1.0))
    view = truth.views[0]
    middles = view.xy_img[4].mean(1)
    regions = [Region(centre_img=at, side_px=200.0) for at in (middles[1], middles[0], np.array([-900.0, -900.0]))]
    (seen,) = oracle.detect([frame(view.camera, int(view.t_ns[4]))], [regions])
    assert np.abs(seen.xy_img[0] - view.xy_img[4, 1]).max() < 25
    assert np.abs(seen.xy_img[1] - view.xy_img[4, 0]).max() < 25
    assert np.isnan(seen.xy_img[2]).all()


def test_what_it_cannot_know_is_an_error(truth):
    oracle = OracleDetector(truth)
    with pytest.raises(InputError, match="no camera 'cam77' in the truth; there are: cam00, cam01, cam02"):
        oracle.detect([frame("cam77", 0)], [None])
    late = frame("cam00", 10_000_000)
    refusal(InputError, r"no true frame within 1 ms.*offset_s and drift_ppm", lambda: oracle.detect([late], [None]))
