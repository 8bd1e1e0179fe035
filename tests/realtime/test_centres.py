"""Joint centres live: what goes out has moved, the poses sent to the views have not, and a recording states by which table."""

from dataclasses import replace

import numpy as np
import pytest
from no_outputs import KeptOutputs, StillPerson

from posefuse.core import (
    JointCentres,
    LiveJointCentres,
)
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.detection import read_card
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.realtime.estimator import Centring, Estimator
from posefuse.realtime.fusion import Fusion
from posefuse.realtime.messages import Expected, SessionClock
from posefuse.tracking import at_joint_centres
from posefuse.tracking.body_directions import segment_lengths

K = len(BLAZEPOSE33)
FULL = read_joint_centres(read_card("blazepose_full").joint_centres_file)
PERIOD_NS = 10_000_000
BEGIN_NS = 1_700_000_000_000_000_000


def centres(cameras: tuple[str, ...], table: JointCentres | None) -> LiveJointCentres:
    return LiveJointCentres(t_ns=BEGIN_NS, cameras=cameras, table=table)


def still(xyz: np.ndarray) -> StillPerson:
    return StillPerson(xyz, BLAZEPOSE33)


@pytest.fixture
def standing_person() -> np.ndarray:
    return np.random.default_rng(5).normal(size=(K, 3)) * 0.3 + [0, 0, 1.0]


@pytest.mark.parametrize("wanted", [True, False])
def test_the_output_is_at_joint_centres_and_the_views_get_landmarks(ring_rig, standing_person, wanted) -> None:
    rig, kept, tracker = ring_rig(3), KeptOutputs(), still(standing_person)
    expected_by_cameras: list[Expected] = []
    fusion = Fusion(rig, Estimator(tracker, Centring(rig.names, wanted)), expected_by_cameras.append, SessionClock.begin(), kept)
    fusion.tick(BEGIN_NS, PERIOD_NS)
    fusion.take(centres(rig.names, FULL))
    fusion.tick(BEGIN_NS + 5 * PERIOD_NS, PERIOD_NS)
    before, after = kept.poses()
    expected = at_joint_centres(before, FULL, FULL.usual).xyz_world if wanted else before.xyz_world
    np.testing.assert_array_equal(before.xyz_world[0], standing_person)
    np.testing.assert_array_equal(after.xyz_world, expected)
    np.testing.assert_array_equal(expected_by_cameras[-1].xyz_world[0], standing_person)
    assert (np.abs(after.xyz_world - before.xyz_world).max() > 0.01) == wanted
    assert fusion.estimator.centring.made_by == (dict.fromkeys(rig.names, FULL.made_by) if wanted else {})
    # the table belongs to the views, wanted or not
    offered = [message for message in kept.offered if isinstance(message, LiveJointCentres)]
    assert [(message.cameras, message.table) for message in offered] == [(rig.names, FULL)]


def test_where_networks_differ_the_first_camera_with_a_table_counts(standing_person) -> None:
    pose, other = still(standing_person).at(0), JointCentres(made_by="another", offsets={"hip": {"up": 0.05}})
    centring = Centring("abc", wanted=True)
    centring.learn(centres(("c", "stranger"), FULL))
    np.testing.assert_array_equal(centring.moved(pose).xyz_world, at_joint_centres(pose, FULL, FULL.usual).xyz_world)
    centring.learn(centres(("a",), None))
    centring.learn(centres(("b",), other))
    np.testing.assert_array_equal(centring.moved(pose).xyz_world, at_joint_centres(pose, other, other.usual).xyz_world)
    assert centring.made_by == {"b": "another", "c": FULL.made_by}


def test_the_table_of_one_who_is_followed_for_long_counts_by_length(standing_person) -> None:
    """The same table sent again does not make any person a stranger; another one does."""
    centring, tracker = Centring("ab", wanted=True), still(standing_person)
    centring.learn(centres(("a",), FULL))
    shown = [centring.moved(tracker.at(i * PERIOD_NS)).xyz_world for i in range(3000)]
    usual = at_joint_centres(tracker.at(0), FULL, FULL.usual).xyz_world
    lengths = segment_lengths(np.broadcast_to(usual, (10, 1, K, 3)), BLAZEPOSE33)
    known = at_joint_centres(tracker.at(0), FULL, lengths).xyz_world
    np.testing.assert_array_equal(shown[0], usual)
    assert np.abs(known - usual).max() > 0.005
    assert np.abs(known - shown[-1]).max() < 0.0005
    assert np.abs(np.diff(shown, axis=0)).max() < 0.2 * np.abs(known - usual).max()
    centring.learn(centres(("b",), read_joint_centres(read_card("blazepose_full").joint_centres_file)))
    assert np.abs(centring.moved(tracker.at(3000 * PERIOD_NS)).xyz_world - shown[-1]).max() < 0.0001
    centring.learn(centres(("a",), replace(FULL, made_by="another")))
    np.testing.assert_array_equal(centring.moved(tracker.at(3001 * PERIOD_NS)).xyz_world, usual)
