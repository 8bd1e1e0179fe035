"""The network that a node without ROS talks on: its settings, and one Cyclone DDS domain per id and process."""

from __future__ import annotations

import socket
from collections.abc import Mapping
from typing import Annotated, Any
from weakref import WeakValueDictionary
from xml.sax.saxutils import quoteattr

from annotated_types import Ge, Le

from posefuse.core import ConfigError, DependencyError, SourceError
from posefuse.core.errors import choices
from posefuse.foundation.settings import settings

from .types import optional_module

TESTED_CYCLONEDDS = "11.0.1"
# of one domain on one machine
_PARTICIPANTS = 32


@settings
class NetworkSettings:
    """Settings of what has a node.

    Attributes:
        domain_id: ROS_DOMAIN_ID; nodes of different domains do not receive each other's messages (0 to 232).
        local_only: nothing leaves this machine.
        interface: name of a network interface; empty lets Cyclone DDS choose.
        peers: addresses of other machines, for networks without multicast.
    """

    domain_id: Annotated[int, Ge(0), Le(232)] = 0
    local_only: bool = False
    interface: str = ""
    peers: tuple[str, ...] = ()

    @property
    def network(self) -> Network:
        """Where the node talks."""
        return Network(domain_id=self.domain_id, local_only=self.local_only, interface=self.interface, peers=tuple(self.peers))


@settings
class Network(NetworkSettings):
    """Where a node talks.

    Attributes:
        multicast: find others by multicast too.
        fragment_bytes: largest UDP payload of one fragment. The default suits wired networks and Fast DDS readers;
            on links that lose packets take about 1300, so that one lost packet costs one fragment.
    """

    multicast: bool = True
    fragment_bytes: int = 65000

    def __post_init__(self) -> None:
        if not 0 <= self.domain_id <= 232:
            raise ConfigError(f"network: domain_id: expected 0 to 232, got {self.domain_id}")
        if self.local_only and (self.peers or self.interface):
            raise ConfigError("network: local_only excludes peers and interface; leave one of them out")
        if not 500 <= self.fragment_bytes <= 65000:
            raise ConfigError(f"network: fragment_bytes: expected 500 to 65000, got {self.fragment_bytes}")


def network_of(ros: Mapping[str, Any] | None) -> Network:
    """Where a session with these options meets, see `posefuse.live`."""
    return Network(**{key: value for key, value in (ros or {}).items() if key != "sim_time"})


def domain_xml(network: Network) -> str:
    """Cyclone DDS configuration. Peers are always asked at their unicast ports, this machine included."""
    interface = "lo" if network.local_only else network.interface
    chosen = f"name={quoteattr(interface)}" if interface else 'autodetermine="true"'
    multicast = network.multicast and not network.local_only
    peers = "".join(f"<Peer Address={quoteattr(peer)}/>" for peer in dict.fromkeys(("localhost", *network.peers)))
    return (
        '<CycloneDDS xmlns="https://cdds.io/config"><Domain Id="any">'
        f"<General><Interfaces><NetworkInterface {chosen}/></Interfaces>"
        f"<AllowMulticast>{'default' if multicast else 'false'}</AllowMulticast>"
        f"<MaxMessageSize>{network.fragment_bytes + 500}B</MaxMessageSize>"
        f"<FragmentSize>{network.fragment_bytes}B</FragmentSize></General>"
        "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
        f"<MaxAutoParticipantIndex>{_PARTICIPANTS - 1}</MaxAutoParticipantIndex>"
        # a peer that was cut off is found again within about this time
        f"<SPDPInterval>1s</SPDPInterval><Peers>{peers}</Peers></Discovery>"
        '<Internal><SocketReceiveBufferSize max="4MB"/></Internal>'
        "</Domain></CycloneDDS>"
    )


class _Domain:
    """Cyclone DDS keeps one domain per id and process; it ends with the last node that holds it."""

    def __init__(self, network: Network) -> None:
        from cyclonedds.core import DDSException
        from cyclonedds.domain import Domain

        self.network = network
        _silence_log()
        try:
            self.entity = Domain(network.domain_id, domain_xml(network))
        except DDSException as error:
            raise SourceError(f"DDS domain {network.domain_id}: cannot be opened; {_why_not_open(network, error)}") from None


def _silence_log() -> None:
    """Keep Cyclone DDS from writing to the terminal, once per process.

    It writes 32 lines a second for every peer that is away, and a line for every malformed packet of anyone, whatever its
    configuration asks for; what matters comes back as return codes.
    """
    from cyclonedds.internal import DDS

    DDS._dll_handle.dds_set_log_mask(0)


def _why_not_open(network: Network, error: Exception) -> str:
    """The cause of a failure, searched afterwards: Cyclone DDS does not report it."""
    there = [name for _, name in socket.if_nameindex()]
    if network.interface and network.interface not in there:
        return f"no network interface {network.interface!r}, there are: {choices(there)}"
    return f"{error}; where other programs use all its UDP ports, choose another domain"


_OPEN: WeakValueDictionary[int, _Domain] = WeakValueDictionary()


def open_domain(network: Network) -> _Domain:
    """The domain of a network, opened on first use; raises SourceError where it cannot be."""
    found = _OPEN.get(network.domain_id)
    if found is None:
        found = _OPEN[network.domain_id] = _Domain(network)
    if found.network != network:
        raise SourceError(f"DDS domain {network.domain_id}: open in this process as {found.network}, asked for as {network}")
    return found


def require_tested_cyclonedds() -> None:
    """Raw bytes go through names the wheel keeps private: only the version they were tested with will do."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        found = version("cyclonedds")
    except PackageNotFoundError:
        found = "none"
    if found != TESTED_CYCLONEDDS:
        raise DependencyError(
            f"cyclonedds: expected version {TESTED_CYCLONEDDS}, got {found}; install it with: pip install 'posefuse[ros]'"
        )
    optional_module("cyclonedds._clayer")


def tested_packages() -> str:
    """For `posefuse doctor`; raises DependencyError where one is missing."""
    require_tested_cyclonedds()
    for name in ("rosbags.typesys", "mcap.writer"):
        optional_module(name)
    return f"Cyclone DDS {TESTED_CYCLONEDDS}, rosbags and mcap"
