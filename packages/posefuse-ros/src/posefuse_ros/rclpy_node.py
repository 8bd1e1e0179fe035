"""A ROS 2 node by rclpy, for machines where a ROS 2 environment is sourced: its own middleware and settings then count.

Bytes are ready-made here, too (`types.encode`); rclpy publishes and hands out serialised messages as they are. A topic whose
type is not installed (`hri_msgs`, `posefuse_msgs`) is left out.
"""

from __future__ import annotations

import os
import threading
from typing import Any

from posefuse.core import Closing, DependencyError

from .dds import KeptSamples
from .topics import Topic
from .types import encode


def ros2_is_sourced() -> bool:
    """Whether a ROS 2 environment was sourced and its rclpy fits this Python."""
    if not os.environ.get("AMENT_PREFIX_PATH"):
        return False
    try:
        import rclpy  # noqa: F401
    except ImportError:
        return False
    return True


class RclpyNode(Closing):
    """Publishes as an rclpy node (`topics.Outlet`), and reads in a thread of its own.

    Attributes:
        left_out: topics whose type is not installed.

    Raises:
        DependencyError: rclpy is not there.
    """

    def __init__(self, name: str, domain_id: int) -> None:
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
            from rosidl_runtime_py.utilities import get_message
        except ImportError as error:
            raise DependencyError(f"rclpy: not usable ({error}); source a ROS 2 environment of this Python version") from None
        self.left_out: set[str] = set()
        self._get_message = get_message
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain_id)
        self._node: Any = rclpy.create_node(name, context=self._context)
        self._publishers: dict[str, Any] = {}
        self._readers: dict[str, KeptSamples] = {}
        self._executor: Any = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin, name="rclpy", daemon=True)
        self._thread.start()

    def publish(self, topic: Topic, msg: Any, t_ns: int) -> None:
        """Send one message; nothing where its type is not installed."""
        publisher = self._publisher(topic)
        if publisher is not None:
            publisher.publish(encode(msg))

    def wanted(self, topic: Topic) -> bool:
        """Whether there are subscribers, or later ones will get the last message."""
        publisher = self._publisher(topic)
        return publisher is not None and (topic.latched or publisher.get_subscription_count() > 0)

    def forget(self, name: str) -> None:
        """Close the publisher of a topic that is no more."""
        publisher = self._publishers.pop(name, None)
        if publisher is not None:
            self._node.destroy_publisher(publisher)

    def reader(self, topic: Topic, *, wakes: bool = True) -> KeptSamples:
        """The reader of `topic`; raises DependencyError where its type is not installed."""
        if topic.name not in self._readers:
            reader = self._readers[topic.name] = KeptSamples(topic)
            kind = self._type(topic)
            if kind is None:
                raise DependencyError(f"topic {topic.name}: {topic.type_name} is not installed in this ROS 2 environment")

            def put(raw: bytes, info: Any) -> None:
                reader.put(raw, int(info["source_timestamp"]))

            self._node.create_subscription(kind, topic.name, put, _profile(topic, topic.latched), raw=True)
        return self._readers[topic.name]

    def close(self) -> None:
        """Leave the network; safe to call twice."""
        if self._node is not None:
            self._executor.shutdown()
            self._node.destroy_node()
            self._context.try_shutdown()
            self._thread.join(1.0)
        self._node = None

    def _publisher(self, topic: Topic) -> Any:
        """None where the type is not installed."""
        if topic.name in self.left_out:
            return None
        if topic.name not in self._publishers:
            kind = self._type(topic)
            if kind is None:
                self.left_out.add(topic.name)
                return None
            self._publishers[topic.name] = self._node.create_publisher(kind, topic.name, _profile(topic, topic.reliable))
        return self._publishers[topic.name]

    def _type(self, topic: Topic) -> Any:
        try:
            return self._get_message(topic.type_name)
        except (AttributeError, ModuleNotFoundError, ValueError):
            return None


def _profile(topic: Topic, reliable: bool) -> Any:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        depth=topic.depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
    )
