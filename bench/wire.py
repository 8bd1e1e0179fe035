"""How long a 3D skeleton travels between two processes of one machine, at 100 Hz.

    python bench/wire.py [--seconds 20]

Each message carries the time of its making; the receiver takes the difference to its own clock (same machine, same
clock) after the value is decoded and checked. So a row is making the message + sending + waking up + reading it:

- ros2         posefuse/pose over Cyclone DDS, from the core value to the core value
- ros2 output  the same while the sender publishes everything RosOutput shows (tf, joints, markers, view)

and per step of the sender, without a network: the cost of everything RosOutput shows, and of OSC and JSON.
Tables on stderr, one JSON object on stdout.
"""

import multiprocessing
import os
import time

import numpy as np
from harness import answer, arguments

from posefuse.core import SE3, SKELETONS, Camera, Pose3D, Rig
from posefuse.outputs.live.udp import json_from_pose, osc_from_pose
from posefuse_ros import topics
from posefuse_ros.dds import RosNode
from posefuse_ros.dds_domain import Network
from posefuse_ros.messages import message_from_pose, pose_from_message
from posefuse_ros.ros_output import RosOutput
from posefuse_ros.types import decode, encode

RATE_HZ = 100
SKELETON = SKELETONS["blazepose33"]
NETWORK = Network(domain_id=100 + os.getpid() % 130, local_only=True)


def a_pose(people: int) -> Pose3D:
    """People of normal size; the time is now."""
    k = len(SKELETON)
    xyz = np.random.default_rng(0).normal(size=(people, k, 3))
    cov = np.tile(np.eye(3) * 1e-4, (people, k, 1, 1))
    shape = (people, k)
    seen = {"reproj_px": np.ones(shape), "n_views": np.full(shape, 4), "kind": np.ones(shape)}
    about = {"t_ns": time.time_ns(), "skeleton": SKELETON, "person_id": np.arange(people)}
    return Pose3D(**about, xyz_world=xyz, cov_world=cov, **seen)


def a_rig() -> Rig:
    """One camera, for the view messages."""
    intrinsics = np.array([[600, 0, 319.5], [0, 600, 239.5], [0, 0, 1.0]])
    return Rig((Camera(name="cam", size_wh=(640, 480), K=intrinsics, cam_from_world=SE3.from_rotvec([0, 0, 0], [0, 0, 4.0])),))


def steadily(seconds: float, step) -> None:
    """Call `step` at RATE_HZ."""
    start = time.monotonic()
    for i in range(int(seconds * RATE_HZ)):
        time.sleep(max(0.0, start + i / RATE_HZ - time.monotonic()))
        step()


def talk(network: Network, seconds: float, people: int, everything: bool) -> None:
    with RosNode("talker", network) as node:
        while not node.writer(topics.POSE).readers():
            time.sleep(0.02)
        output = RosOutput(node, a_rig())
        if everything:
            steadily(seconds, lambda: output.step(a_pose(people)))
        else:
            steadily(seconds, lambda: node.publish(topics.POSE, message_from_pose(a_pose(people), {}), 0))


def over_ros2(seconds: float, people: int, everything: bool) -> list[float]:
    """Ages in ms."""
    ages = []
    with RosNode("listener", NETWORK) as node:
        reader = node.reader(topics.POSE)
        talker = multiprocessing.get_context("spawn").Process(target=talk, args=(NETWORK, seconds, people, everything))
        talker.start()
        while talker.is_alive():
            node.wait(0.2)
            for sample in reader.take():
                pose, _ = pose_from_message(decode(sample.raw, topics.POSE.type_name, 2**20))
                ages.append((time.time_ns() - pose.t_ns) / 1e6)
        talker.join()
    return ages


class Nowhere:
    """An outlet that makes the bytes and drops them."""

    def wanted(self, topic):
        return True

    def publish(self, topic, msg, t_ns):
        encode(msg)

    def forget(self, name):
        pass


def per_step_ms(step, times: int = 300) -> float:
    """Median duration of one call."""
    taken = []
    for _ in range(times):
        start = time.perf_counter()
        step()
        taken.append((time.perf_counter() - start) * 1e3)
    return float(np.median(taken))


def main() -> None:
    args = arguments(__doc__, seconds=20.0)
    rows, steps = [], []
    for people in (1, 2):
        ways = {
            "ros2": over_ros2(args.seconds, people, False),
            "ros2 output": over_ros2(args.seconds, people, True),
        }
        for way, ages in ways.items():
            late = {f"p{share}_ms": float(np.percentile(ages[RATE_HZ // 2 :], share)) for share in (50, 95, 99)}
            rows.append({"way": way, "people": people, "messages": len(ages), **late})
        pose, output = a_pose(people), RosOutput(Nowhere(), a_rig())
        work = {
            "pose": lambda pose=pose: encode(message_from_pose(pose, {})),
            "ros_output": lambda pose=pose, output=output: output.step(pose),
            "osc": lambda pose=pose: osc_from_pose(pose, None, "z_up"),
            "json": lambda pose=pose: json_from_pose(pose, None, "z_up"),
        }
        spent = {f"{name}_ms": per_step_ms(step) for name, step in work.items()}
        steps.append({"people": people, "bytes": len(work["pose"]()), **spent})
    answer(args, {"One way": rows, "One step": steps})


if __name__ == "__main__":
    main()
