"""What a live recording holds: enough for a replay, and for viewers to draw the people unasked."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from posefuse.core import LiveDetections, LivePose, LivePreview
from posefuse.evaluation.contracts import made_up_messages, made_up_start
from posefuse_ros import topics
from posefuse_ros.bags import read_detections, read_mcap, read_poses
from posefuse_ros.markers import annotations_of_view
from posefuse_ros.record import RecordConfig

pytest.importorskip("rosbags", reason="the extra ros is not installed")
MESSAGES = list(made_up_messages())
T0 = 1_700_000_000_000_000_000


def recorded(path: Path, *, images: bool) -> tuple[Path, list]:
    """A second of poses at 100 Hz, and everything else once."""
    config = RecordConfig(path=path, images=images)
    output = config.build()
    output.take(made_up_start(1))
    given = [message for message in MESSAGES if isinstance(message, config.takes)]
    for message in given:
        output.take(message)
    pose = next(message for message in MESSAGES if isinstance(message, LivePose) and len(message.pose.person_id) == 2)
    for i in range(100):
        output.take(replace(pose, pose=replace(pose.pose, t_ns=T0 + i * 10_000_000)))
    output.close()
    output.close()
    return path, given


def test_people_are_drawn_by_two_readers_unasked(tmp_path: Path) -> None:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    path, given = recorded(tmp_path / "a.mcap", images=True)
    count = Counter(one.topic for one in read_mcap(path))
    with path.open("rb") as file:
        assert count == Counter(
            channel.topic for _, channel, _, _ in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        )
    assert {"/tf", "/tf_static", "/posefuse/markers", "/posefuse/cameras", "/diagnostics", "/humans/bodies/tracked"} <= set(count)
    poses = sum(isinstance(message, LivePose) for message in given) + 100
    assert count["/posefuse/pose"] == poses == len(list(read_poses(path)))
    assert len(list(read_detections(path))) == sum(isinstance(message, LiveDetections) for message in given)
    assert count["/posefuse/markers"] == pytest.approx(30, abs=4)
    assert count["/posefuse/markers"] < 40 and not any(name.endswith(("/pose_with_covariance", "/twist")) for name in count)
    previews = [message for message in given if isinstance(message, LivePreview)]
    for preview in previews:
        assert count[topics.preview(preview.camera).name] and count[topics.preview_info(preview.camera).name]
    assert previews


def test_images_are_recorded_on_request_only(tmp_path: Path) -> None:
    path, _ = recorded(tmp_path / "a.mcap", images=False)
    assert LivePreview not in RecordConfig(path=path).takes
    assert not any("preview" in one.topic for one in read_mcap(path))


def test_a_session_that_did_not_start_leaves_no_file(tmp_path: Path) -> None:
    output = RecordConfig(path=tmp_path / "a.mcap").build()
    output.take(made_up_start(1))
    assert (tmp_path / "a.mcap").exists()
    output.close()
    assert list(tmp_path.iterdir()) == []


def test_keypoints_are_drawn_where_they_are_in_the_small_image() -> None:
    view = next(m.detections for m in MESSAGES if isinstance(m, LiveDetections) and len(m.detections) > 0)
    msg = annotations_of_view(view, (320, 240), (640, 480))
    assert len(msg.points) == 2 * len(view)
    bones, points = msg.points[:2]
    seen = view.score[0] > 0
    expected = (view.xy_img[0][seen] + 0.5) / 2
    np.testing.assert_allclose([[p.x, p.y] for p in points.points], expected, rtol=1e-5)
    assert len(points.outline_colors) == len(points.points) and points.type == 1
    assert len(bones.points) == 2 * len(bones.outline_colors) and bones.type == 4
