"""Simulated time in the file of a live session: `/clock` as it was at every pose."""

from __future__ import annotations

from posefuse.messages import topics
from posefuse.messages.dds import RosNode
from posefuse.messages.dds_domain import Network
from posefuse.messages.messages import time_from_ns
from posefuse.messages.sim_time import ClockReader, SimulatedClock
from posefuse.messages.types import message

_WITHIN_S = 10.0


class RecordedClock:
    """Follows `/clock` of a network, and writes it into a recording.

    Raises:
        SourceError: nothing comes on `/clock`.
    """

    def __init__(self, network: Network) -> None:
        self._node = RosNode("posefuse_record", network)
        try:
            self._reader = ClockReader(self._node)
            self._reader.wait(_WITHIN_S)
        except BaseException:
            self._node.close()
            raise

    def keep(self, recorder: topics.Outlet, t_ns: int) -> None:
        """Write the simulated time at `t_ns` of the session."""
        self._reader.update()
        keep_clock(recorder, self._reader.clock, t_ns)

    def close(self) -> None:
        """Leave the network."""
        self._node.close()


def keep_clock(recorder: topics.Outlet, clock: SimulatedClock, t_ns: int) -> None:
    """Write the value of `clock` at `t_ns` of the session."""
    if clock.known:
        recorder.publish(topics.CLOCK, message(topics.CLOCK.type_name, clock=time_from_ns(clock.sim_from_real(t_ns))), t_ns)
