"""Drives a robot over ROS 1 until it is stopped, and prints its first state.

ros1_driver.py FOLDER_OF_ROSPY pose|joints MODEL.xml
"""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path

# last, so that this environment's numpy comes first, as with --system-site-packages
sys.path.append(sys.argv[1])

import numpy as np

from posefuse.core import PosefuseError
from posefuse_teleop.follower import standing
from posefuse_teleop.limits import Motion
from posefuse_teleop.ros_robot import open_ros_robot
from posefuse_teleop.settings import RobotSettings, RosPlan, TeleoperationSettings

command, model = sys.argv[2], Path(sys.argv[3])
plan = RosPlan(version=1, cmd_vel="/cmd_vel", stamped=False)
settings = TeleoperationSettings(robot=RobotSettings(position_xy_m=(2.0, 0.0), heading_deg=90.0))
frame = "right_hand" if command == "joints" else "tool"
try:
    robot = open_ros_robot(command, plan, model if command == "joints" else None, (frame,), settings)
except PosefuseError as error:
    print(type(error).__name__, error)
    sys.exit(1)
first = robot.state()
print(json.dumps([first.xyz_world[0].tolist(), first.q_rad.tolist(), first.fault]), flush=True)
while True:
    moves = Motion(position=first.xyz_world[0] + [0.0, 0.002, 0.0], velocity=np.array([0.0, 0.2, 0.1]))
    robot.move(replace(standing(first.xyz_world, first.wxyz), moves=(moves,), limited=""), 0.01)
    time.sleep(0.02)
    robot.state()
