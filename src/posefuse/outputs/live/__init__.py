"""Outputs of live sessions, plug-ins of the group ``posefuse.live_outputs``: file, ROS, datagrams, LSL, viewer."""

from .lsl import LslConfig
from .record import RecordConfig
from .ros import Ros1Config, Ros2Config
from .udp import JsonConfig, OscConfig
from .viewer import RerunLiveConfig

__all__ = ["JsonConfig", "LslConfig", "OscConfig", "RecordConfig", "RerunLiveConfig", "Ros1Config", "Ros2Config"]
