"""How often whole images are searched while no person is followed."""

from __future__ import annotations

import numpy as np
import pytest

from posefuse.realtime.group import SearchSchedule

PERIOD_S = 1 / 30
STEP = 12


def room(rng: np.random.Generator, person: int = 0, contrast: float = 100.0, noise: float = 5.0) -> np.ndarray:
    """(480, 648, 3) image of a room seen by a noisy camera, with a person as high as so many sampled pixels in it."""
    image = np.full((480, 648, 3), 100.0, np.float32)
    image[10 * STEP : (10 + person) * STEP, 20 * STEP : 21 * STEP] += contrast
    image += noise * rng.standard_normal(image.shape, np.float32)
    return image.clip(0, 255).astype(np.uint8)


def searches(seconds: float, image_at, found_at=lambda t_s: False, period_s: float = PERIOD_S) -> list[float]:
    """Times at which a camera is searched."""
    schedule, done = SearchSchedule(), []
    for t_s in np.arange(0, seconds, period_s):
        sample = image_at(t_s)[::STEP, ::STEP].copy()
        if schedule.due(sample, t_s):
            schedule.searched(sample, t_s, found_at(t_s))
            done.append(float(t_s))
    return done


def of(images: list[np.ndarray]):
    """One after the other, again and again: noise for thousands of images would take the test its time."""
    return lambda t_s: images[round(t_s / PERIOD_S) % len(images)]


def test_a_room_in_which_nothing_changes_is_searched_every_ten_seconds() -> None:
    rng = np.random.default_rng(1)
    waits = np.diff([t_s for t_s in searches(120, of([room(rng) for _ in range(7)])) if t_s > 10])
    assert waits == pytest.approx([10] * len(waits), abs=2 * PERIOD_S)


@pytest.mark.parametrize(("height", "contrast", "within_s"), [(4, 100.0, PERIOD_S), (8, 20.0, 10 + 2 * PERIOD_S)])
def test_a_person_who_comes_in_is_searched_at_once_and_one_too_faint_within_ten_seconds(height, contrast, within_s) -> None:
    rng = np.random.default_rng(4)
    empty, there = [[room(rng, person, contrast) for _ in range(7)] for person in (0, height)]
    done = searches(60, lambda t_s: of(there if t_s >= 47.3 else empty)(t_s))
    assert min(t_s for t_s in done if t_s >= 47.3) < 47.3 + within_s


def test_every_frame_is_searched_while_people_move_or_are_found() -> None:
    rng = np.random.default_rng(3)
    images = {person: room(rng, person) for person in (3, 9)}
    moving = searches(2, lambda t_s: images[3 + round(t_s / PERIOD_S) % 2 * 6])
    found = searches(2, lambda _: images[3], found_at=lambda _: True)
    assert len(moving) == len(found) == 60
