"""A ROS 2 node without ROS: Cyclone DDS underneath, ROS 2's names, types and announcements on top.

Messages are written and read as ready-made CDR bytes (`types.encode`, `types.decode`). What makes other ROS 2
programs and tools see this node in full: topics named ``rt/...``, types named ``pkg::msg::dds_::Type_``, the user data
``enclave=/;`` on the participant and ``typehash=RIHS01_...;`` on each endpoint (REP-2016), and the list of nodes and
their endpoints on ``ros_discovery_info`` (the design document "Node to Participant mapping" of ROS 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from posefuse.core import Closing, SourceError

from .dds_domain import Network, open_domain, require_tested_cyclonedds
from .topics import Topic
from .types import encode, idl_class, message, optional_module, type_hash

GRAPH = Topic("ros_discovery_info", "rmw_dds_common/msg/ParticipantEntitiesInfo", depth=1, latched=True)
_LATCHED_WRITERS = 100
# DDS_RETCODE_TIMEOUT, and how long a write may wait before it
_TIMEOUT = -10
_PATIENCE_MS = 20
_MAX_TAKE = 256
_MOST_SENDERS = 1000


class Sample(NamedTuple):
    """One message as it came.

    Attributes:
        raw: CDR bytes. sent_ns: when the writer sent it, by the writer's clock (Unix epoch).
        sender: the node it came from: its participant, the same for all topics of a node.
    """

    raw: bytes
    sent_ns: int
    sender: str = ""


class Reader:
    """The messages of one topic, newest `depth` kept. Made by `RosNode.reader`."""

    def __init__(self, topic: Topic, entity: Any) -> None:
        self.topic = topic
        self.entity = entity
        self._senders: dict[int, str] = {}

    def take(self) -> list[Sample]:
        """What has come since the last call, oldest first; does not wait."""
        from cyclonedds._clayer import ddspy_take
        from cyclonedds.core import InstanceState, SampleState, ViewState

        found = ddspy_take(self.entity._ref, SampleState.Any | ViewState.Any | InstanceState.Any, _MAX_TAKE)
        if isinstance(found, int):
            raise SourceError(f"topic {self.topic.name}: Cyclone DDS could not read (code {found})")
        return [
            Sample(bytes(raw), int(info.source_timestamp), self._sender(info.publication_handle))
            for raw, info in found
            if info.valid_data
        ]

    def _sender(self, handle: int) -> str:
        """Participant of a writer; one that has left before it was asked for is named by its handle."""
        if handle not in self._senders:
            if len(self._senders) > _MOST_SENDERS:
                self._senders.clear()
            writer = self.entity.get_matched_publication_data(handle)
            self._senders[handle] = str(writer.participant_key) if writer is not None else f"writer {handle}"
        return self._senders[handle]

    def senders(self) -> set[str]:
        """The participants that have matching writers now; one that is gone leaves some seconds later."""
        return {self._sender(handle) for handle in self.entity.get_matched_publications()}


class Writer:
    """Sends messages on one topic. Made by `RosNode.writer`."""

    def __init__(self, topic: Topic, entity: Any) -> None:
        self.topic = topic
        self.entity = entity

    def write(self, raw: bytes) -> None:
        """Send CDR bytes. Of a slow reader's backlog only the newest `depth` are kept; one that holds everything up gets none."""
        from cyclonedds._clayer import ddspy_write

        code = ddspy_write(self.entity._ref, raw)
        if code < 0 and code != _TIMEOUT:
            raise SourceError(f"topic {self.topic.name}: Cyclone DDS could not write {len(raw)} bytes (code {code})")

    def readers(self) -> int:
        """How many matching readers are there now; 0 means that no one listens."""
        return len(self.entity.get_matched_subscriptions())


@dataclass
class RosNode(Closing):
    """One ROS 2 node. Several of one process may share a domain id if they agree on the network.

    Attributes:
        name: as in ``ros2 node list``. network: where it talks.

    Raises:
        DependencyError: Cyclone DDS or rosbags is missing, or Cyclone DDS is another version than the one tested.
        SourceError: the domain cannot be opened (unknown interface, another network on the same id in this process).
    """

    name: str
    network: Network = field(default_factory=Network)

    def __post_init__(self) -> None:
        optional_module("rosbags")
        require_tested_cyclonedds()
        from cyclonedds.core import WaitSet
        from cyclonedds.domain import DomainParticipant
        from cyclonedds.qos import Policy, Qos

        self._writers: dict[str, Writer] = {}
        self._readers: dict[str, Reader] = {}
        self._conditions: dict[str, Any] = {}
        self._domain: Any = open_domain(self.network)
        self._participant: Any = DomainParticipant(self.network.domain_id, qos=Qos(Policy.Userdata(b"enclave=/;")))
        self._waitset: Any = WaitSet(self._participant)
        self._graph_writer: Any = self._open_writer(GRAPH)
        self._announce()

    def writer(self, topic: Topic) -> Writer:
        """The writer of `topic`, made and announced on first use."""
        if topic.name not in self._writers:
            self._writers[topic.name] = self._open_writer(topic)
            self._announce()
        return self._writers[topic.name]

    def reader(self, topic: Topic, *, wakes: bool = True) -> Reader:
        """The reader of `topic`, made and announced on first use; `wait` wakes up for it if it `wakes`.

        It does not ask for lost messages again (but for latched ones): a repeat would hold up all newer ones.
        """
        from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState

        if topic.name not in self._readers:
            reader = self._readers[topic.name] = self._open_reader(topic)
            if wakes:
                condition = ReadCondition(reader.entity, SampleState.Any | ViewState.Any | InstanceState.Any)
                self._waitset.attach(condition)
                self._conditions[topic.name] = condition
            self._announce()
        return self._readers[topic.name]

    def wanted(self, topic: Topic) -> bool:
        """Whether there are subscribers, or later ones will get the last message (`topics.Outlet`)."""
        return self.writer(topic).readers() > 0 or topic.latched

    def forget(self, name: str) -> None:
        """Close the writer of a topic that is no more (`topics.Outlet`)."""
        if self._writers.pop(name, None) is not None:
            self._announce()

    def publish(self, topic: Topic, msg: Any, t_ns: int) -> None:
        """Send one message (`topics.Outlet`)."""
        self.writer(topic).write(encode(msg))

    def wait(self, timeout_s: float) -> bool:
        """Wait until any reader has messages; False when the time is over or the node is closed."""
        from cyclonedds.core import DDSException

        waitset = self._waitset
        try:
            return waitset is not None and bool(waitset.wait(int(timeout_s * 1e9)))
        except DDSException:
            if self._waitset is None:
                return False
            raise

    def topics(self) -> dict[str, set[str]]:
        """ROS topics others publish, with their types (``pkg/msg/Type``)."""
        from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication

        found: dict[str, set[str]] = {}
        for sample in BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication).read(1024):
            if sample.topic_name.startswith("rt/"):
                found.setdefault(sample.topic_name[2:], set()).add(
                    sample.type_name.replace("::dds_::", "/").replace("::", "/").rstrip("_")
                )
        return found

    def close(self) -> None:
        """Leave the network; safe to call twice."""
        self._conditions.clear()
        self._readers.clear()
        self._writers.clear()
        # a caller that waits in another thread still holds the set it waits on
        self._waitset = self._graph_writer = self._participant = self._domain = None

    def _open_writer(self, topic: Topic) -> Writer:
        from cyclonedds.pub import DataWriter

        return Writer(topic, DataWriter(self._participant, self._topic(topic), qos=_qos(topic, topic.depth, topic.reliable)))

    def _open_reader(self, topic: Topic) -> Reader:
        from cyclonedds.sub import DataReader

        # all writers of a topic without keys share one history here, so one latched message each must fit
        depth = max(topic.depth, _LATCHED_WRITERS) if topic.latched else topic.depth
        return Reader(topic, DataReader(self._participant, self._topic(topic), qos=_qos(topic, depth, topic.latched)))

    def _topic(self, topic: Topic) -> Any:
        from cyclonedds.topic import Topic as DdsTopic

        wire_name = topic.name if topic is GRAPH else f"rt{topic.name}"
        return DdsTopic(self._participant, wire_name, idl_class(topic.type_name))

    def _announce(self) -> None:
        """Announce this node and its endpoints."""
        namespace, _, name = self.name.strip("/").rpartition("/")
        node = message(
            "rmw_dds_common/msg/NodeEntitiesInfo",
            node_namespace=f"/{namespace}",
            node_name=name,
            reader_gid_seq=_gids([r.entity for r in self._readers.values()]),
            writer_gid_seq=_gids([w.entity for w in self._writers.values()]),
        )
        (gid,) = _gids([self._participant])
        info = message("rmw_dds_common/msg/ParticipantEntitiesInfo", gid=gid, node_entities_info_seq=[node])
        self._graph_writer.write(encode(info))


def _gids(entities: Sequence[Any]) -> list[Any]:
    return [message("rmw_dds_common/msg/Gid", data=np.frombuffer(entity.guid.bytes, np.uint8)) for entity in entities]


def _qos(topic: Topic, depth: int, reliable: bool) -> Any:
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.util import duration

    return Qos(
        Policy.Reliability.Reliable(duration(milliseconds=_PATIENCE_MS)) if reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if topic.latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(depth),
        Policy.DataRepresentation(use_cdrv0_representation=True),
        Policy.Userdata(f"typehash={type_hash(topic.type_name)};".encode()),
    )
