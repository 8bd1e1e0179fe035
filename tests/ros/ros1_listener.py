"""What plain ROS 1 makes of a running posefuse node; run by the system's Python, prints JSON."""

import json

import rospy
import tf2_ros
from genpy.dynamic import generate_dynamic


def hear(topic):
    """The next message of a topic, read by the definition its publisher sends along; and its checksum."""
    any_msg = rospy.wait_for_message(topic, rospy.AnyMsg, timeout=30)
    sent = any_msg._connection_header
    cls = generate_dynamic(sent["type"], sent["message_definition"])[sent["type"]]
    assert cls._md5sum == sent["md5sum"]
    return cls().deserialize(any_msg._buff), sent["md5sum"]


rospy.init_node("listener", disable_signals=True)
buffer = tf2_ros.Buffer()
tf2_ros.TransformListener(buffer)
state, _ = hear("/humans/bodies/p1/joint_states")
info, _ = hear("/posefuse/cam01/camera_info")
diagnostics, checksum = hear("/diagnostics")
markers, _ = hear("/posefuse/markers")
pose, _ = hear("/posefuse/pose")
found = {}
for frame in ("l_wrist_p1", "cam01_optical_frame"):
    tf = buffer.lookup_transform("world", frame, rospy.Time(0), rospy.Duration(30)).transform
    found[frame] = [tf.translation.x, tf.translation.y, tf.translation.z, tf.rotation.w]
print(
    json.dumps(
        {
            "tf": found,
            "joints": dict(zip(state.name, state.position)),  # noqa: B905 the system's Python may be 3.9
            "stamp_ns": state.header.stamp.secs * 10**9 + state.header.stamp.nsecs,
            "K": list(info.K),
            "D": list(info.D),
            "distortion_model": info.distortion_model,
            "diagnostics": [diagnostics.status[0].level, diagnostics.status[0].values[0].value, checksum],
            "markers": markers.markers[2].text,
            "pose": pose.skeleton,
            "topics": dict(rospy.get_published_topics()),
        }
    )
)
