"""The expected error of a planned rig: the covariance that fusion states, and the errors that really come out."""

from collections.abc import Callable

import numpy as np
import pytest
from checks import refusal

import posefuse as pf
from posefuse.cli.main import main
from posefuse.core import SE3, InputError, Rig
from posefuse.foundation.summary import Facts
from posefuse.fusion import FuseSettings, triangulate
from posefuse_sim.rig_plan import covariance, plan_rig
from posefuse_sim.surroundings import Box

POINTS = np.random.default_rng(3).uniform([-1.2, -1.0, 0.1], [1.2, 1.0, 1.7], (7, 3))
SIGMA_PX = 2.5


def stated(rig: Rig, points: np.ndarray) -> np.ndarray:
    return covariance(rig, points, np.full((len(rig), len(points)), SIGMA_PX))[0]


@pytest.mark.parametrize("distortion", [(), (-0.2, 0.05, 0.001, -0.002, 0.0)])
def test_it_is_what_fusion_states_on_average(ring_rig: Callable[..., Rig], distortion: tuple[float, ...]) -> None:
    # fusion scales by how well the views agree, which is 1 on average
    rig, rng, rounds = ring_rig(5, distortion=distortion), np.random.default_rng(2), 300
    xy = np.stack([camera.project(POINTS) for camera in rig])
    noisy = xy + rng.normal(0, SIGMA_PX, (rounds, *xy.shape))
    _, fused, _ = triangulate(rig, noisy, None, np.full(noisy.shape[:-1], SIGMA_PX))
    expected = stated(rig, POINTS)
    off = np.abs(fused.mean(axis=0) - expected).max(axis=(1, 2)) / np.trace(expected, axis1=1, axis2=2)
    assert off.max() < 0.04


def test_measured_points_are_off_by_what_it_states(ring_rig: Callable[..., Rig]) -> None:
    rig, rng = ring_rig(4), np.random.default_rng(5)
    xy = np.stack([camera.project(POINTS) for camera in rig])
    cov, rounds = stated(rig, POINTS), 300
    noisy = xy + rng.normal(0, SIGMA_PX, (rounds, *xy.shape))
    xyz, _, _ = triangulate(rig, noisy, None, np.full(noisy.shape[:-1], SIGMA_PX), "none")
    off = xyz - POINTS
    square = np.einsum("rki,kij,rkj->rk", off, np.linalg.inv(cov), off)
    # 3 degrees of freedom: mean 3, standard deviation sqrt(6 / draws); the linear solution is at most a tenth worse than the best
    assert -4 * np.sqrt(6 / square.size) < square.mean() - 3 < 0.3


def test_where_fewer_than_two_cameras_see_nothing_is_stated(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(3)
    wall = Box(np.array([0.05, 5.0, 3.0]), SE3.from_rotvec([0, 0, 0], np.array([1.5, 0.0, 0.0])), (0.5, 0.5, 0.5))
    plan, hidden = plan_rig(rig, (3.0, 2.0), step_m=0.25), plan_rig(rig, (3.0, 2.0), step_m=0.25, boxes=(wall,))
    assert plan.n_views.shape == (9, 13, 4)
    np.testing.assert_array_equal(np.isfinite(plan.error_mm), plan.n_views >= 2)
    assert hidden.covered() < plan.covered() <= 1
    assert (hidden.n_views <= plan.n_views).all()
    assert plan.covered(3) <= plan.covered(2)


def test_a_rig_that_covers_nothing_is_summarised_in_words(ring_rig: Callable[..., Rig]) -> None:
    plan = plan_rig(ring_rig(1), (3.0, 2.0), step_m=0.5)
    (facts,) = (block for block in plan.summary() if isinstance(block, Facts))
    shown = dict(facts.shown)
    assert "no place" in shown["keypoint error, one time step"] and "nan" not in str(shown)


def test_a_detector_errs_by_a_share_of_the_person(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4)
    plain = plan_rig(rig, (1.0, 1.5), step_m=0.5)
    twice = plan_rig(rig, (1.0, 1.5), step_m=0.5, noise=FuseSettings(sigma_share=0.03))
    np.testing.assert_allclose(twice.error_mm, 2 * plain.error_mm, rtol=1e-9)
    assert plain.error_at(0.5) < plain.error_at(0.95)
    assert (plain.x_m[0], plain.x_m[-1], plain.y_m[0], plain.y_m[-1]) == (-0.5, 0.5, -0.75, 0.75)


def test_too_many_points_are_refused_with_a_remedy(ring_rig: Callable[..., Rig]) -> None:
    refusal(InputError, "larger step", lambda: plan_rig(ring_rig(2), (50.0, 50.0), step_m=0.01))


def test_a_scene_file_is_planned_without_rendering(tmp_path, capsys) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text("duration_s: 1\ncameras: {kind: ring, count: 4}\nroom: {size_m: [10.0, 10.0]}\n")
    plan = pf.plan(scene, area_m=(3.0, 2.0))
    assert plan.n_views.max() == 4
    assert main(["simulate", str(scene), "--plan", "--json"]) == 0
    assert '"median_mm"' in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == [scene]
