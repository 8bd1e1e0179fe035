"""Sends the image topics of a camera and of a simulator until it is stopped: image_sender.py DOMAIN CAMERAS.pickle.

``/cam``: at 100 Hz, raw and compressed, now and then an older image or one of another size, next to a topic without images.
``/cam00``: at 20 Hz, stamped in simulated time, which passes half as fast as real time, next to ``/clock`` and to the CameraInfo
of the cameras of the file; that of cam02 is uncalibrated.
"""

import pickle
import sys
import time
from pathlib import Path

import numpy as np
from image_messages import jpeg_image, raw_image

from posefuse_ros.camera_messages import CAMERA_INFO_TYPE, COMPRESSED_TYPE, IMAGE_TYPE, info_from_camera
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network
from posefuse_ros.messages import time_from_ns
from posefuse_ros.topics import CLOCK, Topic
from posefuse_ros.types import message

RAW, COMPRESSED = Topic("/cam/image_raw", IMAGE_TYPE), Topic("/cam/image_raw/compressed", COMPRESSED_TYPE)
CHATTER = Topic("/chatter", "std_msgs/msg/String")


def infos(sim_ns: int) -> list:
    """Topic and CameraInfo of each camera."""
    made = {camera.name: info_from_camera(camera, sim_ns) for camera in cameras}
    made["cam02"].k = np.zeros(9)
    return [(Topic(f"/{name}/camera_info", CAMERA_INFO_TYPE), info) for name, info in made.items()]


cameras = pickle.loads(Path(sys.argv[2]).read_bytes())
image, odd = np.zeros((12, 16, 3), np.uint8), np.zeros((6, 8, 3), np.uint8)
image[:, :8] = 200
with RosNode("sender", Network(domain_id=int(sys.argv[1]), local_only=True)) as node:
    begun_s = time.time()
    for i in range(60_000):
        t_ns, sim_ns = 1_700_000_000_000_000_000 + i * 10_000_000, round((time.time() - begun_s) * 0.5e9)
        sent = [(CLOCK, message(CLOCK.type_name, clock=time_from_ns(sim_ns))), (RAW, raw_image(image, t_ns))]
        sent += [(RAW, raw_image(image, t_ns - 50_000_000))] if i % 5 == 1 else []
        sent += [(RAW, raw_image(odd, t_ns + 1))] if i % 5 == 2 else []
        sent += [(COMPRESSED, jpeg_image(image, t_ns)), (CHATTER, message(CHATTER.type_name, data="x"))]
        sent += [(Topic("/cam00/image_raw", IMAGE_TYPE), raw_image(image, sim_ns)), *infos(sim_ns)] if i % 5 == 0 else []
        for topic, msg in sent:
            node.publish(topic, msg, 0)
        if i == 0:
            print("sending", flush=True)
        time.sleep(0.01)
