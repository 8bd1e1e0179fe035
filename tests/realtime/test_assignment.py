"""Cameras dealt to processes: what is left when one is lost."""

from itertools import chain, combinations

import numpy as np
import pytest

from posefuse.realtime.session import blocks


def sigma_left(rig, lost) -> float:
    """Of a point in the middle of the ring, from one ray of each camera that is left."""
    information = np.eye(3) * 1e-2
    for camera in rig:
        if camera.name not in lost:
            ray = np.array([0.0, 0.0, 1.0]) - camera.centre_world
            away = np.linalg.norm(ray)
            information += (camera.K[0, 0] / away) ** 2 * (np.eye(3) - np.outer(ray, ray) / away**2)
    return float(np.sqrt(np.trace(np.linalg.inv(information))))


@pytest.mark.parametrize(("count", "most"), [(3, 1.0), (4, 1.0), (5, 1.03), (6, 1.03), (8, 1.03)])
def test_the_worst_loss_is_nearly_the_least_of_all_assignments_to_two_processes(ring_rig, count, most) -> None:
    rig = ring_rig(count)
    groups = blocks(rig, rig.names, 2)
    assert sorted(chain(*groups)) == sorted(rig.names)
    halves = [(half, set(rig.names) - set(half)) for half in combinations(rig.names, (count + 1) // 2)]
    least = min(max(sigma_left(rig, half) for half in assignment) for assignment in halves)
    assert max(sigma_left(rig, group) for group in groups) <= 1.0001 * most * least


def test_neighbours_share_a_process_in_whatever_order_they_are_named(ring_rig) -> None:
    rig = ring_rig(6)
    shuffled = [rig.names[i] for i in (4, 0, 2, 5, 1, 3)]
    assert blocks(rig, shuffled, 3) == [["cam04", "cam05"], ["cam00", "cam01"], ["cam02", "cam03"]]
    # cameras of other machines are not dealt, but count for the middle
    assert blocks(rig, rig.names[:4], 2) == [["cam00", "cam01"], ["cam02", "cam03"]]
    assert blocks(rig, rig.names[:3], 3) == [["cam00"], ["cam01"], ["cam02"]]
