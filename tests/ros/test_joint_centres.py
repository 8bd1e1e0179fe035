"""Joint centres on the network and in recordings: a table comes back, nonsense is refused, a replay does as the session did."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from replaying import difference_m, replayed

from posefuse.core import Detections2D, JointCentres, LiveDetections, LiveJointCentres, LivePose, LiveStart, MessageError
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.detection import read_card
from posefuse.formats.joint_centres import read_joint_centres
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.realtime.messages import SessionClock
from posefuse.realtime.session import notes_of
from posefuse.tracking import at_joint_centres
from posefuse_ros.camera_messages import joint_centres_from_message, message_from_joint_centres
from posefuse_ros.record import RecordConfig
from posefuse_ros.types import decode, encode

K = len(BLAZEPOSE33)
FULL = read_joint_centres(read_card("blazepose_full").joint_centres_file)
PERIOD_NS = 10_000_000
BEGIN_NS = 1_700_000_000_000_000_000


def centres(cameras: tuple[str, ...], table: JointCentres | None) -> LiveJointCentres:
    return LiveJointCentres(t_ns=BEGIN_NS, cameras=cameras, table=table)


@pytest.fixture
def standing_person() -> np.ndarray:
    return np.random.default_rng(5).normal(size=(K, 3)) * 0.3 + [0, 0, 1.0]


@pytest.mark.parametrize("table", [FULL, JointCentres(made_by="x", offsets={"hip": {"up": 0.01}}), None])
def test_a_table_comes_back_from_the_network(table) -> None:
    msg = message_from_joint_centres(centres(("cam00", "cam02"), table))
    assert joint_centres_from_message(decode(encode(msg), msg.__msgtype__, 2**18)) == centres(("cam00", "cam02"), table)


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
    msg = message_from_joint_centres(centres(("cam00",), SMALL))
    assert joint_centres_from_message(msg).table == SMALL
    for field, value in change.items():
        setattr(msg, field, value)
    with pytest.raises(MessageError, match=words):
        joint_centres_from_message(msg)


def test_a_replay_moves_the_poses_as_the_session_did(ring_rig, standing_person, tmp_path: Path) -> None:
    rig, config = ring_rig(3), LiveConfig()
    path, clock = tmp_path / "live.mcap", SessionClock.begin()
    sink = RecordConfig(path=path).build()
    start_ns, notes = clock.now_ns(), notes_of(rig, config)
    sink.take(LiveStart(t_ns=start_ns, rig=rig, rate_hz=100.0, clock_offset_ns=clock.offset_ns, notes=notes))
    estimator = warmed_up(rig, BLAZEPOSE33, config)
    known = centres(rig.names, FULL)
    sink.take(known)
    estimator.centring.learn(known)
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
