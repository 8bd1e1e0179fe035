"""Live outputs ``osc`` and ``json``: poses as small datagrams for animation and XR tools, to one or many listeners.

Open Sound Control 1.0, and JSON.
"""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import MinLen

from posefuse.core import Closing, ConfigError, JointAngles, LiveMessage, LiveNames, LiveOutput, LivePose, LiveStart, Pose3D
from posefuse.core.arrays import Array
from posefuse.core.poses import point_sigma_m
from posefuse.foundation.settings import settings

# rows: the tool's x, y, z in world axes
AXES = {
    "z_up": np.eye(3),
    "y_up": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "y_up_left_handed": np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
}
_MAX_PACKET = 1400
_NTP_FROM_UNIX_S = 2_208_988_800
_NOW = b"\0\0\0\0\0\0\0\1"
UNNAMED: Mapping[int, str] = MappingProxyType({})


def osc_message(address: str, *arguments: float) -> bytes:
    """One OSC message; int as ``i``, float as ``f``. Raises ConfigError for an address that is not ASCII."""
    tags = "".join("f" if isinstance(argument, float) else "i" for argument in arguments)
    return _text(address) + _text(f",{tags}") + struct.pack(f">{tags}", *arguments)


def osc_bundle(messages: Sequence[bytes], t_ns: int) -> bytes:
    """An OSC bundle of the time step `t_ns` (Unix epoch; "immediately" when before 1970)."""
    seconds, rest_ns = divmod(t_ns, 1_000_000_000)
    tag = struct.pack(">II", (seconds + _NTP_FROM_UNIX_S) % 2**32, (rest_ns << 32) // 1_000_000_000) if t_ns >= 0 else _NOW
    return b"#bundle\0" + tag + b"".join(struct.pack(">i", len(m)) + m for m in messages)


def osc_from_pose(pose: Pose3D, joints: JointAngles | None, axes: str) -> list[bytes]:
    """Datagrams of one time step; `axes` is one of `AXES`."""
    people = [int(person) for person in pose.person_id]
    datagrams = [osc_bundle([osc_message("/posefuse/people", *people)], pose.t_ns)]
    for n, person in enumerate(people):
        messages = [
            osc_message(f"/posefuse/{person}/{name}", *xyz, sigma) for name, xyz, sigma in _keypoints(pose, n, AXES[axes])
        ]
        messages += [osc_message(f"/posefuse/{person}/{name}", value) for name, value in _angles(joints, person)]
        datagrams += [osc_bundle(part, pose.t_ns) for part in _packets(messages)]
    return datagrams


def json_from_pose(pose: Pose3D, joints: JointAngles | None, axes: str, names: Mapping[int, str] = UNNAMED) -> list[bytes]:
    """Datagrams of one time step, one per person; `axes` is one of `AXES`, `names` those of the people by id."""
    datagrams = []
    for n, person in enumerate(int(person) for person in pose.person_id):
        keypoints = list(_keypoints(pose, n, AXES[axes]))
        content = {
            "t_ns": pose.t_ns,
            "person": person,
            **({"name": name} if (name := names.get(person)) else {}),
            "skeleton": pose.skeleton.name,
            "axes": axes,
            "keypoints": {name: [round(v, 5) for v in xyz] for name, xyz, _ in keypoints},
            "sigma_m": {name: round(sigma, 5) for name, _, sigma in keypoints if sigma > 0},
            "angles_rad": {name: round(value, 5) for name, value in _angles(joints, person)},
        }
        datagrams.append(json.dumps(content, separators=(",", ":")).encode())
    return datagrams


def _keypoints(pose: Pose3D, n: int, turn: Array) -> Iterator[tuple[str, list[float], float]]:
    """Name, (x, y, z) and standard deviation over the three axes of what is known of person n."""
    xyz = pose.xyz_world[n] @ turn.T
    sigma = point_sigma_m(pose.cov_world[n])
    for name, place, spread in zip(pose.skeleton.keypoints, xyz.tolist(), sigma.tolist(), strict=True):
        if np.isfinite(place).all():
            yield name, place, spread if np.isfinite(spread) else 0.0


def _angles(joints: JointAngles | None, person: int) -> Iterator[tuple[str, float]]:
    if joints is None:
        return
    for n in np.flatnonzero(joints.person_id == person):
        for joint, names, angles in zip(joints.joints, joints.angle_names, joints.angle_rad[-1, n].tolist(), strict=True):
            yield from ((f"{joint}/{name}", value) for name, value in zip(names, angles, strict=True) if np.isfinite(value))


def _packets(messages: Sequence[bytes]) -> Iterator[list[bytes]]:
    part: list[bytes] = []
    size = 16
    for message in messages:
        if part and size + 4 + len(message) > _MAX_PACKET:
            yield part
            part, size = [], 16
        part.append(message)
        size += 4 + len(message)
    if part:
        yield part


def _text(value: str) -> bytes:
    if not value.isascii():
        raise ConfigError(f"OSC text: expected ASCII, got {value!r}")
    raw = value.encode("ascii") + b"\0"
    return raw + bytes(-len(raw) % 4)


class UdpStream(Closing):
    """Sends datagrams to fixed addresses; never waits, and continues when a listener or the network is away.

    Raises:
        ConfigError: an address that is not ``host:port``, or a host that is not known.
    """

    def __init__(self, addresses: Sequence[str]) -> None:
        self._targets = [_resolved(address) for address in addresses]
        self._sockets = {family: socket.socket(family, socket.SOCK_DGRAM) for family in {one for one, _ in self._targets}}
        for opened in self._sockets.values():
            opened.setblocking(False)

    def send(self, datagrams: Sequence[bytes]) -> None:
        """Send each datagram to every address."""
        for family, target in self._targets:
            for datagram in datagrams:
                with suppress(OSError):
                    self._sockets[family].sendto(datagram, target)

    def close(self) -> None:
        """Safe to call twice."""
        for opened in self._sockets.values():
            opened.close()


def _host_and_port(address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise ConfigError(f"UDP address: expected host:port with a port of 1 to 65535, got {address!r}")
    return host.strip("[]"), int(port)


def _resolved(address: str) -> tuple[int, tuple[object, ...]]:
    try:
        family, _, _, _, target = socket.getaddrinfo(*_host_and_port(address), type=socket.SOCK_DGRAM)[0]
    except OSError as error:
        raise ConfigError(f"UDP address {address!r}: the host is not known ({error})") from None
    return family, target


Axes = Literal["z_up", "y_up", "y_up_left_handed"]
Packets = Callable[[Pose3D, JointAngles | None, str, Mapping[int, str]], list[bytes]]


@settings
class _Listeners:
    """Where datagrams go.

    Attributes:
        to: ``host:port``, one or several. axes: of the receiving tool.
    """

    to: Annotated[tuple[str, ...], MinLen(1)]
    axes: Axes = "z_up"
    takes: ClassVar[tuple[type[LiveMessage], ...]] = (LivePose,)
    keeps_all: ClassVar[bool] = False


@settings
class OscConfig(_Listeners):
    """Poses as OSC bundles over UDP."""

    def build(self) -> LiveOutput:
        """Not yet opened."""
        return UdpOutput("osc", self.to, self.axes, lambda pose, joints, axes, _: osc_from_pose(pose, joints, axes))


@settings
class JsonConfig(_Listeners):
    """Poses as JSON datagrams over UDP, one per person."""

    takes: ClassVar[tuple[type[LiveMessage], ...]] = (LivePose, LiveNames)

    def build(self) -> LiveOutput:
        """Not yet opened."""
        return UdpOutput("json", self.to, self.axes, json_from_pose)


class UdpOutput:
    """Sends each pose to every address; a network that is away loses datagrams and is no failure."""

    def __init__(self, name: str, addresses: tuple[str, ...], axes: str, packets: Packets) -> None:
        # names are resolved when it is opened; what no name can be is refused before a session begins
        for address in addresses:
            _host_and_port(address)
        self.name, self.where = name, ", ".join(addresses)
        self._addresses, self._axes, self._packets = addresses, axes, packets
        self._stream: Any = None
        self._names: dict[int, str] = {}

    def take(self, message: LiveMessage) -> None:
        """See `LiveOutput`."""
        match message:
            case LiveStart():
                self._stream, self._names = UdpStream(self._addresses), dict(enumerate(message.names))
            case LiveNames(names=names):
                self._names |= names
            case LivePose():
                self._stream.send(self._packets(message.pose, message.joints, self._axes, self._names))

    def close(self) -> None:
        """Close the socket."""
        if self._stream is not None:
            self._stream.close()
