"""A robot of plain ROS 1, run by the system's Python: tells where it is, and prints the first command on each topic as JSON.

ros1_robot.py JOINTS(JSON: name -> rad) TOPIC...
"""

import json
import sys
import time

import rospy
from genpy.dynamic import generate_dynamic
from geometry_msgs.msg import TransformStamped
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

joints, topics = json.loads(sys.argv[1]), sys.argv[2:]
rospy.init_node("robot", disable_signals=True)
received = {}


def hear(any_msg, topic):
    sent = any_msg._connection_header
    cls = generate_dynamic(sent["type"], sent["message_definition"])[sent["type"]]
    assert cls._md5sum == sent["md5sum"]
    received.setdefault(topic, [sent["type"], str(cls().deserialize(any_msg._buff))])


states = rospy.Publisher("/joint_states", JointState, queue_size=1)
tf = rospy.Publisher("/tf", TFMessage, queue_size=1)
for topic in topics:
    rospy.Subscriber(topic, rospy.AnyMsg, hear, callback_args=topic)
end = time.time() + 30
while time.time() < end and len(received) < len(topics):
    state = JointState(name=list(joints), position=list(joints.values()))
    state.header.stamp = rospy.Time.now()
    states.publish(state)
    place = TransformStamped(child_frame_id="tool")
    place.header.frame_id = "base_link"
    place.transform.translation.x, place.transform.translation.z = 0.3, 0.5
    place.transform.rotation.w = 1.0
    tf.publish(TFMessage([place]))
    time.sleep(0.02)
print(json.dumps(received))
