"""The dead-man's switch as heartbeats: at least ten a second while held, none when it is released, fails or is disconnected."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .settings import GateSettings


@dataclass(frozen=True, kw_only=True)
class Beat:
    """One heartbeat. seq: counts up. sent_ns: when, on the gate's clock. grip: close the gripper."""

    seq: int
    sent_ns: int
    grip: bool = False


@dataclass(frozen=True, kw_only=True)
class Heartbeats:
    """What was received.

    Attributes:
        seq, grip: of the newest heartbeat. last_ns: when it was sent. count: in a row.
        heard_ns: when the last one of any kind came: heartbeats that come too late show that the switch is still held.
    """

    seq: int = -1
    last_ns: int | None = None
    heard_ns: int | None = None
    count: int = 0
    grip: bool = False

    def with_beat(self, beat: Beat, now_ns: int, settings: GateSettings) -> Heartbeats:
        """After one more heartbeat. A duplicate, one that overtook another, a late one and one from the future do not count."""
        longest_ns = settings.heartbeat_s * 1e9
        heard = replace(self, heard_ns=now_ns)
        if beat.seq <= self.seq or not 0 <= now_ns - beat.sent_ns <= longest_ns:
            return heard
        if self.last_ns is not None and beat.sent_ns < self.last_ns:
            return heard
        in_a_row = self.last_ns is not None and beat.sent_ns - self.last_ns <= longest_ns
        count = self.count + 1 if in_a_row else 1
        return replace(heard, seq=beat.seq, last_ns=beat.sent_ns, count=count, grip=beat.grip)

    def held(self, now_ns: int, settings: GateSettings) -> bool:
        """Whether the switch is held now: enough heartbeats in a row, the newest one new enough."""
        return self.count >= settings.beats_to_engage and _new(self.last_ns, now_ns, settings)

    def let_go(self, now_ns: int, settings: GateSettings) -> bool:
        """Whether the switch is released: no heartbeat of any kind for so long that one would have come."""
        return not _new(self.heard_ns, now_ns, settings)


def _new(t_ns: int | None, now_ns: int, settings: GateSettings) -> bool:
    return t_ns is not None and 0 <= now_ns - t_ns <= settings.heartbeat_s * 1e9
