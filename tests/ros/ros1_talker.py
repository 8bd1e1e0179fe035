"""A posefuse ROS 1 node until it is stopped: ros1_talker.py FOLDER_OF_ROSPY POSE_FILE."""

import pickle
import sys
import time
from pathlib import Path

# last, so that this environment's numpy comes first, as with --system-site-packages
sys.path.append(sys.argv[1])

from posefuse.core import PosefuseError
from posefuse_ros.messages import diagnostic_status
from posefuse_ros.ros1 import Ros1Node
from posefuse_ros.ros_output import RosOutput

pose, rig = pickle.loads(Path(sys.argv[2]).read_bytes())
try:
    with Ros1Node("posefuse") as node:
        output = RosOutput(node, rig)
        output.start(0)
        while True:
            output.step(pose)
            output.diagnose(pose.t_ns, [diagnostic_status("camera cam00", 1, "slow", {"age": "3 s"})])
            time.sleep(0.02)
except PosefuseError as error:
    print(type(error).__name__, error)
