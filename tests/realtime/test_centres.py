"""Joint centres live: what goes out has moved, the poses sent to the views have not, and a recording states by which table."""

from dataclasses import replace
from pathlib import Path

import built
import numpy as np
import pytest
from replaying import difference_m, replayed

from posefuse.core import (
    Detections2D,
    JointCentres,
    LiveDetections,
    LiveJointCentres,
    LiveMessage,
    LivePose,
    LiveStart,
    MessageError,
    Pose3D,
)
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.detection import read_card
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.messages.types import decode, encode
from posefuse.outputs.live import RecordConfig
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import Centring, Estimator, centres_from_message, live_centres, message_from_centres, warmed_up
from posefuse.realtime.fusion import Fusion
from posefuse.realtime.messages import Centres, Expected, SessionClock
from posefuse.realtime.provenance import notes_of
from posefuse.tracking import at_joint_centres
from posefuse.tracking.segments import segment_lengths

K = len(BLAZEPOSE33)
FULL = read_joint_centres(read_card("blazepose_full").joint_centres_file)
PERIOD_NS = 10_000_000
BEGIN_NS = 1_700_000_000_000_000_000


class Kept:
    """Outlets that keep what they are offered."""

    def __init__(self) -> None:
        self.offered: list[LiveMessage] = []

    def offer(self, message: LiveMessage) -> None:
        self.offered.append(message)


class Still:
    """A tracker of a person who stands still."""

    health: dict = {}  # noqa: RUF012 - never written

    def __init__(self, xyz: np.ndarray) -> None:
        self._xyz = xyz

    def at(self, t_ns: int) -> Pose3D:
        return built.pose(self._xyz[None], t_ns=t_ns, skeleton=BLAZEPOSE33)

    looked_for = at

    def check(self) -> None:
        """Nothing can wait."""


@pytest.fixture
def standing_person() -> np.ndarray:
    return np.random.default_rng(5).normal(size=(K, 3)) * 0.3 + [0, 0, 1.0]


@pytest.mark.parametrize("wanted", [True, False])
def test_the_output_is_at_joint_centres_and_the_views_get_landmarks(ring_rig, standing_person, wanted) -> None:
    rig, kept, tracker = ring_rig(3), Kept(), Still(standing_person)
    expected_by_cameras: list[Expected] = []
    fusion = Fusion(rig, Estimator(tracker, Centring(rig.names, wanted)), expected_by_cameras.append, SessionClock.begin(), kept)
    fusion.tick(BEGIN_NS, PERIOD_NS)
    fusion.take(Centres(rig.names, FULL))
    fusion.tick(BEGIN_NS + 5 * PERIOD_NS, PERIOD_NS)
    before, after = (message.pose for message in kept.offered if isinstance(message, LivePose))
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
    pose, other = Still(standing_person).at(0), JointCentres(made_by="another", offsets={"hip": {"up": 0.05}})
    centring = Centring("abc", wanted=True)
    centring.learn(Centres(("c", "stranger"), FULL))
    np.testing.assert_array_equal(centring.moved(pose).xyz_world, at_joint_centres(pose, FULL, FULL.usual).xyz_world)
    centring.learn(Centres(("a",), None))
    centring.learn(Centres(("b",), other))
    np.testing.assert_array_equal(centring.moved(pose).xyz_world, at_joint_centres(pose, other, other.usual).xyz_world)
    assert centring.made_by == {"b": "another", "c": FULL.made_by}


def test_the_table_of_one_who_is_followed_for_long_counts_by_length(standing_person) -> None:
    """The same table sent again does not make any person a stranger; another one does."""
    centring, tracker = Centring("ab", wanted=True), Still(standing_person)
    centring.learn(Centres(("a",), FULL))
    shown = [centring.moved(tracker.at(i * PERIOD_NS)).xyz_world for i in range(3000)]
    usual = at_joint_centres(tracker.at(0), FULL, FULL.usual).xyz_world
    lengths = segment_lengths(np.broadcast_to(usual, (10, 1, K, 3)), BLAZEPOSE33)
    known = at_joint_centres(tracker.at(0), FULL, lengths).xyz_world
    np.testing.assert_array_equal(shown[0], usual)
    assert np.abs(known - usual).max() > 0.005
    assert np.abs(known - shown[-1]).max() < 0.0005
    assert np.abs(np.diff(shown, axis=0)).max() < 0.2 * np.abs(known - usual).max()
    centring.learn(Centres(("b",), read_joint_centres(read_card("blazepose_full").joint_centres_file)))
    assert np.abs(centring.moved(tracker.at(3000 * PERIOD_NS)).xyz_world - shown[-1]).max() < 0.0001
    centring.learn(Centres(("a",), replace(FULL, made_by="another")))
    np.testing.assert_array_equal(centring.moved(tracker.at(3001 * PERIOD_NS)).xyz_world, usual)


@pytest.mark.parametrize("table", [FULL, JointCentres(made_by="x", offsets={"hip": {"up": 0.01}}), None])
def test_a_table_comes_back_from_the_network(table) -> None:
    msg = message_from_centres(Centres(("cam00", "cam02"), table), BEGIN_NS)
    assert centres_from_message(decode(encode(msg), msg.__msgtype__, 2**18)) == Centres(("cam00", "cam02"), table)


SMALL = JointCentres(
    made_by="x", offsets={"hip": {"up": 0.01}}, lengths={"thigh": 0.4}, by_length={"hip": {"up": {"thigh": 0.1}}}
)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"joint": ["tail"]}, "no joint 'tail'"),
        ({"direction": ["sideways"]}, "no direction 'sideways'"),
        ({"segment": ["tail"]}, "no segment 'tail'"),
        ({"slope_segment": ["shank"]}, "no segment 'shank'"),
        ({"slope_joint": ["tail"]}, "no joint 'tail'"),
        ({"offset_m": np.array([np.nan])}, "offset_m: nan cannot be"),
        ({"offset_m": np.array([7.0])}, "offset_m: 7 cannot be"),
        ({"length_m": np.array([-0.4])}, "length_m: -0.4 cannot be"),
        ({"slope": np.array([np.inf])}, "slope: inf cannot be"),
        ({"slope": np.array([-2.0])}, "slope: -2 cannot be"),
        ({"offset_m": np.zeros(2)}, "as many names as numbers"),
        ({"direction": []}, "as many names as numbers"),
        ({"slope_joint": []}, "as many names as numbers"),
        ({"joint": 600 * ["hip"], "direction": 600 * ["up"], "offset_m": np.zeros(600)}, "512 at most"),
        ({"joint": 2 * ["hip"], "direction": 2 * ["up"], "offset_m": np.zeros(2)}, "each name once"),
        ({"cameras": []}, "1 to 512 cameras, got 0"),
        ({"cameras": 600 * ["cam00"]}, "1 to 512 cameras, got 600"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused(change, words) -> None:
    msg = message_from_centres(Centres(("cam00",), SMALL), BEGIN_NS)
    assert centres_from_message(msg).table == SMALL
    for field, value in change.items():
        setattr(msg, field, value)
    with pytest.raises(MessageError, match=words):
        centres_from_message(msg)


def test_a_replay_moves_the_poses_as_the_session_did(ring_rig, standing_person, tmp_path: Path) -> None:
    rig, config = ring_rig(3), LiveConfig()
    path, clock = tmp_path / "live.mcap", SessionClock.begin()
    sink = RecordConfig(path=path).build()
    start_ns, notes = clock.now_ns(), notes_of(rig, config)
    sink.take(LiveStart(t_ns=start_ns, rig=rig, rate_hz=100.0, clock_offset_ns=clock.offset_ns, notes=notes))
    estimator = warmed_up(rig, BLAZEPOSE33, config)
    centres = Centres(rig.names, FULL)
    sink.take(live_centres(centres, BEGIN_NS))
    estimator.centring.learn(centres)
    for i in range(30):
        t_ns = BEGIN_NS + i * PERIOD_NS
        camera = rig.cameras[i % 3]
        xy, ones = camera.project(standing_person)[None], np.ones((1, K))
        view = Detections2D(
            camera=camera.name, t_ns=t_ns, skeleton=BLAZEPOSE33, xy_img=xy, score=ones, sigma_px=ones, box_img=np.zeros((1, 4))
        )
        sink.take(LiveDetections(detections=view))
        estimator.add(view)
        sink.take(LivePose(pose=estimator.at(t_ns)))
    sink.close()
    pairs = list(replayed(path, rig, config))
    assert len(pairs) == 30 and len(pairs[-1][0].person_id) == 1
    assert max(difference_m(pose, again) for pose, again in pairs) == 0.0
    np.testing.assert_array_equal(pairs[-1][0].cov_world, pairs[-1][1].cov_world)
    # what was learnt on the way counts
    usual = at_joint_centres(estimator.tracker.at(BEGIN_NS + 29 * PERIOD_NS), FULL, FULL.usual)
    assert difference_m(usual, pairs[-1][1]) > 0.001
    landmarks = replace(config, joint_centres=False)
    assert max(difference_m(pose, again) for pose, again in replayed(path, rig, landmarks)) > 0.01
