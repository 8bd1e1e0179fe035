"""Cameras dealt to processes: what is left when one is lost."""

from itertools import chain, combinations

import numpy as np
import pytest

from posefuse.realtime import assignment as dealing
from posefuse.realtime.assignment import dealt


def variance_left(rig, lost) -> float:
    """Of a point in the middle of the ring, from one ray of each camera that is left."""
    information = np.eye(3) * 1e-2
    for camera in rig:
        if camera.name not in lost:
            ray = np.array([0.0, 0.0, 1.0]) - camera.centre_world
            away = np.linalg.norm(ray)
            information += (camera.K[0, 0] / away) ** 2 * (np.eye(3) - np.outer(ray, ray) / away**2)
    return float(np.trace(np.linalg.inv(information)))


def opposite(rig, names) -> bool:
    """Whether two cameras of a ring face each other."""
    one, other = (rig[name].centre_world[:2] for name in names)
    return bool(one @ other < -0.99 * np.linalg.norm(one) * np.linalg.norm(other))


def test_no_lost_group_of_four_leaves_two_cameras_opposite_each_other(ring_rig) -> None:
    rig = ring_rig(4)
    # as they were dealt before, they would have been
    assert opposite(rig, rig.names[::2]) and opposite(rig, rig.names[1::2])
    groups = dealt(rig, rig.names, 2)
    assert [len(group) for group in groups] == [2, 2]
    assert not any(opposite(rig, group) for group in groups)


@pytest.mark.parametrize("count", [3, 5, 6, 8])
def test_the_worst_loss_is_the_least_of_all_deals_into_two(ring_rig, count) -> None:
    rig = ring_rig(count)
    groups = dealt(rig, rig.names, 2)
    assert sorted(chain(*groups)) == sorted(rig.names)
    halves = [(half, set(rig.names) - set(half)) for half in combinations(rig.names, (count + 1) // 2)]
    least = min(max(variance_left(rig, half) for half in deal) for deal in halves)
    assert max(variance_left(rig, group) for group in groups) <= 1.0001 * least


def test_cameras_of_other_machines_count_as_left(ring_rig) -> None:
    rig = ring_rig(6)
    own = rig.names[:4]
    groups = dealt(rig, own, 2)
    assert sorted(chain(*groups)) == sorted(own)
    least = min(max(variance_left(rig, g) for g in (half, set(own) - set(half))) for half in combinations(own, 2))
    assert max(variance_left(rig, group) for group in groups) <= 1.0001 * least


def test_one_process_each_and_one_for_all(ring_rig) -> None:
    rig = ring_rig(3)
    assert dealt(rig, rig.names, 3) == [["cam00"], ["cam01"], ["cam02"]]
    assert dealt(rig, rig.names, 1) == [["cam00", "cam01", "cam02"]]


@pytest.mark.parametrize("count", [4, 6, 8])
def test_equally_good_assignments_are_decided_by_name_not_by_rounding(ring_rig, count, monkeypatch) -> None:
    """A ring has several equally good assignments; what another processor makes of the last bits must not choose."""
    rig = ring_rig(count)
    expected, rng = dealt(rig, rig.names, 2), np.random.default_rng(3)
    exact = dealing._information
    if count == 4:
        assert expected == [["cam00", "cam01"], ["cam02", "cam03"]]
    for _ in range(40):
        noise = 1 + 1e-13 * rng.standard_normal((count, 3, 3))
        monkeypatch.setattr(dealing, "_information", lambda one, noise=noise: exact(one) * noise)
        assert dealt(rig, rig.names, 2) == expected
