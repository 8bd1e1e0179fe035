"""Stands for a running Gazebo with its bridge: images, CameraInfo and /clock of a world, from a session of the same scene.

stand_in.py DOMAIN WORLD SESSION RATE: simulated time passes RATE times as fast as real time; the motion is repeated.
"""

import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "support"))

import numpy as np
from image_messages import raw_image

from posefuse.formats.rig import read_rig
from posefuse.formats.truth import read_loop
from posefuse.sources.video import VideoConfig
from posefuse_ros.camera_messages import CAMERA_INFO_TYPE, IMAGE_TYPE, info_from_camera
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network
from posefuse_ros.messages import time_from_ns
from posefuse_ros.topics import CLOCK, Topic
from posefuse_ros.types import message
from posefuse_sim.gazebo.world import CENTRE_PX

domain, world, session, rate = int(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]), float(sys.argv[4])
rig, loop_ns = read_rig(world / "rig.toml"), read_loop(world / "truth")
frames = {name: list(VideoConfig(session / "videos" / f"{name}.mp4", name).build().frames()) for name in rig.names}
shown = sorted(((frame.t_ns, name, frame.image) for name in rig.names for frame in frames[name]), key=lambda one: one[:2])
STEP_NS = 10_000_000


def info(camera, t_ns):
    """As Gazebo publishes it: it counts pixels from the edge of the image."""
    msg = info_from_camera(camera, t_ns)
    shift = np.array([0, 0, CENTRE_PX, 0, 0, CENTRE_PX, 0, 0, 0])
    msg.k = msg.k + shift
    return msg


with RosNode("gz_bridge", Network(domain_id=domain, local_only=True)) as node:
    begun_s, sim_ns, turn, i = time.monotonic(), 0, 0, 0
    while True:
        node.publish(CLOCK, message(CLOCK.type_name, clock=time_from_ns(sim_ns)), sim_ns)
        while turn * loop_ns + shown[i][0] <= sim_ns:
            t_ns, name, image = turn * loop_ns + shown[i][0], *shown[i][1:]
            node.publish(Topic(f"/{name}/image", IMAGE_TYPE), raw_image(image, t_ns), t_ns)
            node.publish(Topic(f"/{name}/camera_info", CAMERA_INFO_TYPE), info(rig[name], t_ns), t_ns)
            turn, i = (turn + 1, 0) if i + 1 == len(shown) else (turn, i + 1)
        sim_ns += STEP_NS
        time.sleep(max(0.0, begun_s + sim_ns / 1e9 / rate - time.monotonic()))
