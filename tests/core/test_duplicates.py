"""One body that a view reports several times."""

from collections.abc import Sequence

import numpy as np
import pytest
from built import detections

from posefuse.core import Detections2D
from posefuse.core.duplicates import duplicates
from posefuse.core.skeleton import COCO17

K = len(COCO17)
BODY = np.random.default_rng(4).uniform([0, 0], [60, 200], (K, 2))
SIDE = np.ptp(BODY, axis=0).max()


def seen(*people: np.ndarray, scores: Sequence[float] = (0.9, 0.9)) -> Detections2D:
    return detections("a", np.stack(people), score=np.array(scores)[:, None], sigma_px=1.0)


def with_nan(first: int, end: int) -> np.ndarray:
    return np.where(np.isin(np.arange(K), range(first, end))[:, None], np.nan, BODY)


@pytest.mark.parametrize(
    ("people", "scores", "left_out"),
    [
        pytest.param([BODY, BODY + [0.06 * SIDE, 0]], [0.9, 0.9], [False, True], id="nearer than the share of the box"),
        pytest.param([BODY, BODY + [0.1 * SIDE, 0]], [0.9, 0.9], [False, False], id="farther away"),
        pytest.param([BODY, BODY + 1], [0.5, 0.9], [True, False], id="the surer one stays"),
        pytest.param([BODY, BODY + 1], [0.9, 0.5], [False, True], id="whatever the order"),
        pytest.param([BODY, BODY + 1 + 300 * (np.arange(K) < 6)[:, None]], [0.9, 0.9], [False, True], id="six of another body"),
        pytest.param([BODY, BODY[COCO17.mirror] + 1], [0.9, 0.9], [False, True], id="left and right swapped"),
        pytest.param([BODY, BODY + [400, 0], BODY + 1, BODY + 2], [0.9] * 4, [False, False, True, True], id="three times"),
        pytest.param([with_nan(8, K), with_nan(0, 6)], [0.9, 0.9], [False, False], id="hardly a common keypoint"),
    ],
)
def test_one_body_that_is_reported_twice_is_one(people: list[np.ndarray], scores: list[float], left_out: list[bool]) -> None:
    assert duplicates(seen(*people, scores=scores), 0.08).tolist() == left_out


def test_no_person_and_share_zero() -> None:
    assert duplicates(Detections2D.empty("a", 0, COCO17), 0.08).tolist() == []
    assert not duplicates(seen(BODY, BODY), 0.0).any()
