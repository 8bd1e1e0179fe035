"""Outputs of live sessions, plug-ins of the group ``posefuse.live_outputs``: datagrams, LSL, viewer."""

from .lsl import LslConfig
from .udp import JsonConfig, OscConfig
from .viewer import RerunLiveConfig
