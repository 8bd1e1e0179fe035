"""Identity metrics against cases whose figures follow by hand."""

import numpy as np
import pytest
from checks import refusal

from bench.crowds import crowd_figures, frame_matches, person_distances, returned_right
from posefuse.core import ShapeError

RATE_HZ = 30.0
FRAMES = 60


def lines(people: int, frames: int = FRAMES) -> np.ndarray:
    """(T, N, 4, 3) people two metres apart."""
    xyz = np.zeros((frames, people, 4, 3))
    xyz[..., 0] = 2.0 * np.arange(people)[:, None]
    xyz[..., 2] = np.linspace(0, 1.5, 4)
    return xyz


def figures(truth: np.ndarray, result: np.ndarray, asked: np.ndarray | None = None):
    asked = np.isfinite(truth[..., 0]).any(-1) if asked is None else asked
    there = np.isfinite(result[..., 0]).any(-1)
    return crowd_figures(person_distances(truth, result), asked, there, RATE_HZ)


def test_the_truth_itself_is_perfect_under_any_names() -> None:
    truth = lines(3)
    got = figures(truth, truth[:, [2, 0, 1]])
    assert (got.idf1, got.hota, got.switches, got.missed, got.false) == (1, pytest.approx(1), 0, 0, 0)
    assert got.mpjpe_mm == 0


def test_two_ids_exchanged_half_way() -> None:
    truth = lines(2)
    result = truth.copy()
    result[FRAMES // 2 :] = truth[FRAMES // 2 :, [1, 0]]
    got = figures(truth, result)
    assert got.idf1 == pytest.approx(0.5)
    assert got.switches == 2
    assert got.per_person_minute == pytest.approx(2 / (2 * FRAMES / RATE_HZ / 60))
    # every pair shares half of the frames of each: 30 of 30 + 30 + 30
    assert got.association == pytest.approx(1 / 3)
    assert got.hota == pytest.approx(np.sqrt(1 / 3))
    assert got.detection == pytest.approx(1)


def test_misses_and_false_people_count_once_each() -> None:
    truth = lines(2)
    result = np.concatenate([truth, truth[:, :1] + [0, 5.0, 0]], axis=1)
    result[:15, 1] = np.nan
    got = figures(truth, result)
    assert got.missed == pytest.approx(15 / 120)
    assert got.false == pytest.approx(60 / 120)
    right, all_results = 105, 165
    assert got.idf1 == pytest.approx(2 * right / (120 + all_results))
    assert got.switches == 0


def test_an_error_of_a_tenth_of_the_gate_passes_17_of_19_alphas() -> None:
    truth = lines(1)
    got = figures(truth, truth + [0.051, 0, 0])
    assert got.mpjpe_mm == pytest.approx(51)
    assert got.hota == pytest.approx(17 / 19)


def test_who_is_hidden_neither_helps_nor_harms() -> None:
    truth = lines(2)
    asked = np.ones((FRAMES, 2), bool)
    asked[20:40, 1] = False
    result = truth.copy()
    both, one = figures(truth, result, asked), result.copy()
    one[20:40, 1] = np.nan
    assert both == figures(truth, one, asked)
    assert both.idf1 == 1


@pytest.mark.parametrize(("back_as", "right"), [(1, 1), (2, 0)])
def test_the_id_of_one_who_returns(back_as: int, right: int) -> None:
    truth = lines(2)
    truth[20:35, 1] = np.nan
    result = np.full((FRAMES, 3, 4, 3), np.nan)
    result[:, 0], result[:20, 1], result[35:, back_as] = truth[:, 0], truth[:20, 1], truth[35:, 1]
    asked = np.isfinite(truth[..., 0]).any(-1)
    matches = frame_matches(person_distances(truth, result), asked)
    assert returned_right(matches, asked, away_frames=10, settled_frames=5) == (right, 1)


def test_other_keypoints_are_refused() -> None:
    refusal(ShapeError, "expected", lambda: person_distances(lines(1), lines(1)[:, :, :3]))
