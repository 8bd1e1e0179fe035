"""Floods the topic of the views as fast as it can: flooder.py DOMAIN COUNT RIG.toml. Prints how many went out, in how long."""

import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "support"))

import numpy as np
from absurd import absurd_message

from posefuse.formats.rig import read_rig
from posefuse_ros import topics
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network

domain, count, rig = int(sys.argv[1]), int(sys.argv[2]), read_rig(Path(sys.argv[3]))
rng = np.random.default_rng(0)


messages = []
for _ in range(500):
    t_ns = int(rng.integers(0, 2**60)) if rng.random() < 0.5 else time.time_ns()
    messages.append(absurd_message(rng, rig.names, t_ns, int(rng.integers(-(2**60), 2**60))))
with RosNode("flooder", Network(domain_id=domain, local_only=True)) as node:
    writer = node.writer(topics.DETECTIONS)
    while not writer.readers():
        time.sleep(0.05)
    begun_s = time.monotonic()
    for i in range(count):
        writer.write(messages[i % len(messages)])
    print(f"{count} {time.monotonic() - begun_s:.2f}", flush=True)
    time.sleep(0.5)
