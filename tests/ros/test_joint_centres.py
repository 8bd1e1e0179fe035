"""Joint centres on the network: a table comes back, nonsense is refused."""

import numpy as np
import pytest

from posefuse.core import JointCentres, LiveJointCentres, MessageError
from posefuse.detection import read_card
from posefuse.formats.joint_centres import read_joint_centres
from posefuse_ros.camera_messages import joint_centres_from_message, message_from_joint_centres
from posefuse_ros.types import decode, encode

FULL = read_joint_centres(read_card("blazepose_full").joint_centres_file)
BEGIN_NS = 1_700_000_000_000_000_000


def centres(cameras: tuple[str, ...], table: JointCentres | None) -> LiveJointCentres:
    return LiveJointCentres(t_ns=BEGIN_NS, cameras=cameras, table=table)


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
