"""Distance to the operator's body: exact for what is known, less for what is not."""

from dataclasses import replace

import numpy as np
import pytest

from posefuse.teleoperation.hands import BODY
from bench.rehearsal.person import person_view
from posefuse.teleoperation.separation import OperatorBody, distances_to_segments, remembered, separation_m, speed_share
from posefuse.teleoperation.settings import SeparationSettings

EXACT = SeparationSettings(sigmas=0.0, approach_mps=0.0)
HAND = np.array([0.3, -0.25, 1.1])
NOW_NS = 10**12
SPHERE = np.array([[2.0, -0.25, 1.1, 0.1]])


def body(**changes):
    return remembered(OperatorBody.unknown(), replace(person_view(HAND, NOW_NS), **changes))


def test_distances_agree_with_a_fine_search():
    rng = np.random.default_rng(0)
    points, start, end = rng.normal(size=(7, 3)), rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    share = np.linspace(0, 1, 20001)[:, None]
    for b in range(5):
        line = start[b] + share * (end[b] - start[b])
        searched = np.linalg.norm(points[:, None] - line, axis=-1).min(axis=1)
        assert distances_to_segments(points, start, end)[:, b] == pytest.approx(searched, abs=1e-4)


def test_the_stretched_fingers_count():
    # the fingertips are 0.2 m beyond the wrist, limbs 0.08 m thick
    assert separation_m(body(), SPHERE, NOW_NS, EXACT) == pytest.approx(2.0 - 0.5 - 0.08 - 0.1)


def test_what_is_unsure_or_old_counts_as_nearer():
    settings = SeparationSettings(sigmas=2.0, approach_mps=1.6)
    exact = separation_m(body(), SPHERE, NOW_NS, EXACT)
    assert separation_m(body(), SPHERE, NOW_NS, settings) == pytest.approx(exact - 0.02)
    assert separation_m(body(), SPHERE, NOW_NS + 100_000_000, settings) == pytest.approx(exact - 0.02 - 0.16)


def test_a_limb_that_is_hidden_is_remembered_for_a_while():
    hidden = np.ones(len(BODY), bool)
    hidden[[BODY.index("right_wrist"), BODY.index("right_fingertips")]] = False
    later = NOW_NS + 500_000_000
    after = remembered(body(), replace(person_view(HAND - 0.2, later), body_measured=hidden))
    assert separation_m(after, SPHERE, later, EXACT) == pytest.approx(2.0 - 0.5 - 0.08 - 0.1)
    forgotten = later + 2_000_000_000
    after = remembered(after, replace(person_view(HAND - 0.2, forgotten), body_measured=hidden))
    assert separation_m(after, SPHERE, forgotten, EXACT) > 1.5


def test_without_the_trunk_nothing_is_known_and_nothing_moves():
    unseen = np.ones(len(BODY), bool)
    unseen[BODY.index("left_hip")] = False
    for unknown in (OperatorBody.unknown(), body(body_measured=unseen), body(person_id=-1)):
        distance = separation_m(unknown, SPHERE, NOW_NS, EXACT)
        assert np.isnan(distance) and speed_share(distance, EXACT) == 0.0


def test_the_speed_falls_from_slow_to_stop():
    assert [speed_share(d, SeparationSettings()) for d in (2.0, 0.8, 0.6, 0.4, 0.1, -1.0)] == pytest.approx([1, 1, 0.5, 0, 0, 0])
