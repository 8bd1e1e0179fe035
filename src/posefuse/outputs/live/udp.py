"""Live outputs ``osc`` and ``json``: poses as datagrams, see `messages.osc`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import MinLen

from posefuse.core import JointAngles, LiveMessage, LiveOutput, LivePose, LiveStart, Pose3D
from posefuse.foundation.settings import settings
from posefuse.messages.osc import json_from_pose, osc_from_pose

Axes = Literal["z_up", "y_up", "y_up_left_handed"]
Packets = Callable[[Pose3D, JointAngles | None, str, tuple[str, ...]], list[bytes]]


@settings
class OscConfig:
    """Poses as OSC bundles over UDP.

    Attributes:
        to: ``host:port``, one or several. axes: of the receiving tool.
    """

    to: Annotated[tuple[str, ...], MinLen(1)]
    axes: Axes = "z_up"
    takes: ClassVar[tuple[type[LiveMessage], ...]] = (LivePose,)
    keeps_all: ClassVar[bool] = False

    def build(self) -> LiveOutput:
        """Not yet opened."""
        return UdpOutput("osc", self.to, self.axes, lambda pose, joints, axes, _: osc_from_pose(pose, joints, axes))


@settings
class JsonConfig:
    """Poses as JSON datagrams over UDP, one per person.

    Attributes:
        to: ``host:port``, one or several. axes: of the receiving tool.
    """

    to: Annotated[tuple[str, ...], MinLen(1)]
    axes: Axes = "z_up"
    takes: ClassVar[tuple[type[LiveMessage], ...]] = (LivePose,)
    keeps_all: ClassVar[bool] = False

    def build(self) -> LiveOutput:
        """Not yet opened."""
        return UdpOutput("json", self.to, self.axes, json_from_pose)


class UdpOutput:
    """Sends each pose to every address; a network that is away loses datagrams and is no failure."""

    def __init__(self, name: str, addresses: tuple[str, ...], axes: str, packets: Packets) -> None:
        self.name, self._addresses, self._axes, self._packets = name, addresses, axes, packets
        self._stream: Any = None
        self._person_names: tuple[str, ...] = ()

    @property
    def where(self) -> str:
        """The addresses."""
        return ", ".join(self._addresses)

    def take(self, message: LiveMessage) -> None:
        """See `LiveOutput`."""
        from posefuse.messages.osc import UdpStream

        match message:
            case LiveStart():
                self._stream, self._person_names = UdpStream(self._addresses), message.names
            case LivePose():
                self._stream.send(self._packets(message.pose, message.joints, self._axes, self._person_names))

    def close(self) -> None:
        """Close the socket."""
        if self._stream is not None:
            self._stream.close()
