"""Floods the topic of the views as fast as it can: flooder.py DOMAIN COUNT RIG.toml. Prints how many went out, in how long."""

import sys
import time
from pathlib import Path

import numpy as np

from posefuse.core import SKELETONS, Detections2D
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse.formats.rig import read_rig
from posefuse_ros import topics
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network
from posefuse_ros.messages import message_from_detections
from posefuse_ros.types import encode

domain, count, rig = int(sys.argv[1]), int(sys.argv[2]), read_rig(Path(sys.argv[3]))
rng = np.random.default_rng(0)


def one() -> bytes:
    """Valid bytes of absurd content: other skeletons, cameras that do not exist, stamps and places anywhere, wrong counts."""
    skeleton = BLAZEPOSE33 if rng.random() < 0.7 else SKELETONS["coco17"]
    shape = (int(rng.integers(0, 4)), len(skeleton))
    scale = 10.0 ** rng.integers(-10, 10)
    view = Detections2D(
        camera=str(rng.choice([*rig.names, "elsewhere"])),
        t_ns=int(rng.integers(0, 2**60)) if rng.random() < 0.5 else time.time_ns(),
        skeleton=skeleton,
        xy_img=rng.normal(size=(*shape, 2)) * scale,
        score=rng.uniform(0, 1, shape),
        sigma_px=rng.uniform(1e-6, 1e6, shape),
        box_img=rng.normal(size=(shape[0], 4)) * scale,
    )
    msg = message_from_detections(view, {"received": int(rng.integers(-(2**60), 2**60))})
    if rng.random() < 0.3:
        msg.people = int(rng.integers(0, 2**32))
    return encode(msg)


messages = [one() for _ in range(500)]
with RosNode("flooder", Network(domain_id=domain, local_only=True)) as node:
    writer = node.writer(topics.DETECTIONS)
    while not writer.readers():
        time.sleep(0.05)
    begun_s = time.monotonic()
    for i in range(count):
        writer.write(messages[i % len(messages)])
    print(f"{count} {time.monotonic() - begun_s:.2f}", flush=True)
    time.sleep(0.5)
