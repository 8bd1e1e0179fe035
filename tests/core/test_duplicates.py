"""One body that a view reports several times."""

import numpy as np
import pytest
from built import detections

from posefuse.core import Detections2D
from posefuse.core.duplicates import duplicates
from posefuse.core.skeleton import COCO17

K = len(COCO17)
BODY = np.random.default_rng(4).uniform([0, 0], [60, 200], (K, 2))
SIDE = np.ptp(BODY, axis=0).max()


def seen(*people: np.ndarray, scores: tuple[float, ...] | None = None) -> Detections2D:
    xy = np.stack(people)
    return detections("a", xy, score=np.array(scores or [0.9] * len(people))[:, None], sigma_px=1.0)


@pytest.mark.parametrize(("share", "twice"), [(0.06, True), (0.1, False)])
def test_closer_than_the_share_of_the_box_is_one_body(share: float, twice: bool) -> None:
    assert duplicates(seen(BODY, BODY + [share * SIDE, 0]), 0.08).tolist() == [False, twice]


def test_the_surer_one_stays_whatever_the_order() -> None:
    assert duplicates(seen(BODY, BODY + 1, scores=(0.5, 0.9)), 0.08).tolist() == [True, False]
    assert duplicates(seen(BODY, BODY + 1, scores=(0.9, 0.5)), 0.08).tolist() == [False, True]


def test_a_few_keypoints_taken_from_another_body_change_nothing() -> None:
    other = BODY + 1
    other[:6] += 300
    assert duplicates(seen(BODY, other), 0.08).tolist() == [False, True]


def test_left_and_right_exchanged_is_the_same_body() -> None:
    assert duplicates(seen(BODY, BODY[COCO17.mirror] + 1), 0.08).tolist() == [False, True]


def test_three_times_one_body_is_one() -> None:
    assert duplicates(seen(BODY, BODY + [400, 0], BODY + 1, BODY + 2), 0.08).tolist() == [False, False, True, True]


def test_detections_with_hardly_a_common_keypoint_are_left_alone() -> None:
    upper, lower = BODY.copy(), BODY.copy()
    upper[8:], lower[:8] = np.nan, np.nan
    assert not duplicates(seen(upper, lower), 0.08).any()


def test_no_person_and_share_zero() -> None:
    assert duplicates(Detections2D.empty("a", 0, COCO17), 0.08).tolist() == []
    assert not duplicates(seen(BODY, BODY), 0.0).any()
