"""How often whole images are searched while no person is followed."""

from __future__ import annotations

import numpy as np
import pytest

from posefuse.realtime.searching import SearchSchedule

PERIOD_S = 1 / 30


def room(rng: np.random.Generator, person: int = 0) -> np.ndarray:
    """Sampled pixels of a room seen by a noisy camera, with a person of so many pixels in it."""
    sample = 100 + 5.0 * rng.normal(size=(40, 54, 3))
    sample[10 : 10 + person, 20:22] = 200
    return sample.clip(0, 255).astype(np.uint8)


def searches(seconds: float, sample_at, found_at=lambda t_s: False) -> list[float]:
    """Times at which a camera of 30 frames/s is searched."""
    schedule, done = SearchSchedule(), []
    for t_s in np.arange(0, seconds, PERIOD_S):
        sample = sample_at(t_s)
        if schedule.due(sample, t_s):
            schedule.searched(sample, t_s, found_at(t_s))
            done.append(float(t_s))
    return done


def test_a_room_in_which_nothing_changes_is_searched_ever_more_rarely() -> None:
    rng = np.random.default_rng(1)
    done = searches(120, lambda _: room(rng))
    waits = np.diff(done)
    assert len(done) < 20
    assert waits.max() == pytest.approx(10, abs=2 * PERIOD_S)
    assert (np.diff(waits) > -2 * PERIOD_S).all()


def test_a_person_who_comes_in_is_searched_at_once() -> None:
    rng = np.random.default_rng(2)
    done = searches(60, lambda t_s: room(rng, person=4 if t_s >= 47.3 else 0))
    assert min(t_s for t_s in done if t_s >= 47.3) < 47.3 + PERIOD_S


def test_every_frame_is_searched_while_people_move_or_are_found() -> None:
    rng = np.random.default_rng(3)
    moving = searches(2, lambda t_s: room(rng, person=3 + round(t_s / PERIOD_S) % 2 * 3))
    found = searches(2, lambda _: room(rng), found_at=lambda _: True)
    assert len(moving) == len(found) == 60
