"""A stranger on the network: Cyclone DDS with types written by hand, nothing of posefuse. Run as a program.

peer.py look DOMAIN XML      what it sees of the node that publishes /tf, as JSON
peer.py shout DOMAIN XML     sends wrong and good messages on /posefuse/detections until it is stopped
"""

import json
import sys
import time
import uuid

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsParticipant, BuiltinTopicDcpsPublication
from cyclonedds.core import Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import array, bounded_str, float32, float64, int32, sequence, uint8, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration


def struct(typename, **fields):
    return final(make_idl_struct(typename.rsplit(".", 1)[1], typename, fields))


Time = struct("builtin_interfaces.msg.dds_.Time_", sec=int32, nanosec=uint32)
Header = struct("std_msgs.msg.dds_.Header_", stamp=Time, frame_id=str)
Vector3 = struct("geometry_msgs.msg.dds_.Vector3_", x=float64, y=float64, z=float64)
Quaternion = struct("geometry_msgs.msg.dds_.Quaternion_", x=float64, y=float64, z=float64, w=float64)
Transform = struct("geometry_msgs.msg.dds_.Transform_", translation=Vector3, rotation=Quaternion)
TransformStamped = struct("geometry_msgs.msg.dds_.TransformStamped_", header=Header, child_frame_id=str, transform=Transform)
TFMessage = struct("tf2_msgs.msg.dds_.TFMessage_", transforms=sequence[TransformStamped])
Gid = struct("rmw_dds_common.msg.dds_.Gid_", data=array[uint8, 16])
NodeInfo = struct(
    "rmw_dds_common.msg.dds_.NodeEntitiesInfo_", node_namespace=bounded_str[256], node_name=bounded_str[256],
    reader_gid_seq=sequence[Gid], writer_gid_seq=sequence[Gid],
)  # fmt: skip
Graph = struct("rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_", gid=Gid, node_entities_info_seq=sequence[NodeInfo])
Stage = struct("posefuse_msgs.msg.dds_.Stage_", name=str, stamp=Time)
Detections2D = struct(
    "posefuse_msgs.msg.dds_.Detections2D_", header=Header, camera=str, skeleton=str, keypoints=sequence[str], people=uint32,
    xy_px=sequence[float32], score=sequence[float32], sigma_px=sequence[float32], box_px=sequence[float32],
    clothing_lab=sequence[float32], depth_m=sequence[float32], stages=sequence[Stage], captured=uint64, used=uint64,
)  # fmt: skip
RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
XCDR1 = Policy.DataRepresentation(use_cdrv0_representation=True)


def gid(sent):
    return str(uuid.UUID(bytes=bytes(sent.data)))


def nodes_of(infos):
    return [
        {
            "participant": gid(info.gid),
            "name": f"{one.node_namespace} {one.node_name}",
            "writers": [*map(gid, one.writer_gid_seq)],
        }
        for info in infos
        for one in info.node_entities_info_seq
    ]


def writers_of(publications):
    return {
        p.topic_name: {
            "gid": str(p.key),
            "participant": str(p.participant_key),
            "type": p.type_name,
            "user_data": bytes(p.qos[Policy.Userdata].data).decode(),
        }
        for p in publications.read(1000)
        if p.topic_name.startswith("rt/")
    }


def look(participant):
    latched = Qos(RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(100))
    tf = DataReader(participant, Topic(participant, "rt/tf", TFMessage), qos=Qos(RELIABLE))
    static = DataReader(participant, Topic(participant, "rt/tf_static", TFMessage), qos=latched)
    graph = DataReader(participant, Topic(participant, "ros_discovery_info", Graph), qos=latched)
    moving = next(tf.take_iter(timeout=duration(seconds=20)))
    standing = next(static.take_iter(timeout=duration(seconds=20)))
    publications = BuiltinDataReader(participant, BuiltinTopicDcpsPublication)
    known = BuiltinDataReader(participant, BuiltinTopicDcpsParticipant)
    # announcements come one after the other: complete when every topic wanted has a writer that the graph knows
    end, complete, nodes = time.monotonic() + 30, False, []
    while time.monotonic() < end and not complete:
        time.sleep(0.05)
        nodes, writers = nodes_of(graph.take(100)[-1:]) or nodes, writers_of(publications)
        in_graph = {one for node in nodes for one in node["writers"]}
        complete = {"rt/tf", "rt/posefuse/pose"} <= set(writers) and {one["gid"] for one in writers.values()} <= in_graph
    user_data = {str(p.key): bytes(p.qos[Policy.Userdata].data).decode() for p in known.read(100) if Policy.Userdata in p.qos}
    first = moving.transforms[0]
    found = {
        "writers": writers,
        "participants": user_data,
        "nodes": nodes,
        "tf": [first.header.frame_id, first.child_frame_id, first.header.stamp.sec, first.transform.translation.z],
        "tf_static": [t.child_frame_id for t in standing.transforms],
    }
    print(json.dumps(found), flush=True)


def shout(participant):
    topic = Topic(participant, "rt/posefuse/detections", Detections2D)
    writer = DataWriter(participant, topic, qos=Qos(RELIABLE, Policy.History.KeepLast(100), XCDR1))
    known = Header(Time(5, 6), "c"), "stranger", "two", ["a", "b"]
    good = Detections2D(*known, 1, [1.0, 2.0, 3.0, 4.0], [0.5, 1.0], [1.0, 1.0], [0.0, 0.0, 9.0, 9.0], [], [],
                        [Stage("captured", Time(5, 6))], 0, 0)  # fmt: skip
    many = Detections2D(*known, 4_000_000_000, [], [], [], [], [], [], [], 0, 0)
    big = Detections2D(*known, 1, [0.5] * 600_000, [], [], [], [], [], [], 0, 0)
    end = time.monotonic() + 60
    while time.monotonic() < end:
        for one in (good, many, big):
            writer.write(one)
        time.sleep(0.05)


if __name__ == "__main__":
    what, domain_id, xml = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    domain = Domain(domain_id, xml)
    {"look": look, "shout": shout}[what](DomainParticipant(domain_id))
