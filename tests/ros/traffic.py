"""Sends or hears 3D poses at 100 Hz; run as a program on one of two machines.

traffic.py send DOMAIN PEER COUNT          waits for a reader, then sends; prints when it has matched and is done
traffic.py hear DOMAIN PEER SECONDS        prints one JSON list per message: its number and age in ns
"""

import json
import sys
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "support"))

import built
import numpy as np

from posefuse.core import SKELETONS
from posefuse_ros import topics
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network
from posefuse_ros.messages import message_from_pose, pose_from_message
from posefuse_ros.types import Intake

SKELETON = SKELETONS["blazepose33"]


def pose(number):
    return built.pose(np.full((1, len(SKELETON), 3), float(number)), [number], time.time_ns(), skeleton=SKELETON)


def send(node, count):
    writer = node.writer(topics.POSE)
    while not writer.readers():
        time.sleep(0.05)
    print("matched", flush=True)
    started = time.monotonic()
    for number in range(count):
        node.publish(topics.POSE, message_from_pose(pose(number), {}), 0)
        time.sleep(max(0.0, started + 0.01 * (number + 1) - time.monotonic()))
    print("done", flush=True)
    time.sleep(1)


def hear(node, seconds):
    reader = node.reader(topics.POSE)
    intake = Intake(topics.POSE.type_name, pose_from_message)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        node.wait(0.1)
        for sample in reader.take():
            value = intake.take(sample.raw)
            assert value is not None, intake.counts.last_refusal
            print(json.dumps([int(value[0].person_id[0]), time.time_ns() - value[0].t_ns]), flush=True)


if __name__ == "__main__":
    what, domain_id, peer, number = sys.argv[1:]
    with RosNode(what, Network(domain_id=int(domain_id), peers=(peer,) if peer else (), multicast=not peer)) as node:
        {"send": send, "hear": hear}[what](node, int(number))
