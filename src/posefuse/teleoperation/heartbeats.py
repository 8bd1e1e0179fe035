"""The dead-man's switch as heartbeats: at least ten a second while held, none when it is released, fails or is disconnected."""

from __future__ import annotations

from dataclasses import dataclass

from .settings import GateSettings


@dataclass(frozen=True, kw_only=True)
class Beat:
    """One heartbeat. seq: counts up. sent_ns: when, on the gate's clock. grip: close the gripper."""

    seq: int
    sent_ns: int
    grip: bool = False


@dataclass(frozen=True, kw_only=True)
class Heartbeats:
    """What was received. seq, grip: of the newest heartbeat. last_ns: when it was sent. count: in a row."""

    seq: int = -1
    last_ns: int | None = None
    count: int = 0
    grip: bool = False

    def with_beat(self, beat: Beat, now_ns: int, settings: GateSettings) -> Heartbeats:
        """After one more heartbeat. A duplicate, one that overtook another, a late one and one from the future do not count."""
        longest_ns = settings.heartbeat_s * 1e9
        if beat.seq <= self.seq or not 0 <= now_ns - beat.sent_ns <= longest_ns:
            return self
        if self.last_ns is not None and beat.sent_ns < self.last_ns:
            return self
        in_a_row = self.last_ns is not None and beat.sent_ns - self.last_ns <= longest_ns
        return Heartbeats(seq=beat.seq, last_ns=beat.sent_ns, count=self.count + 1 if in_a_row else 1, grip=beat.grip)

    def held(self, now_ns: int, settings: GateSettings) -> bool:
        """Whether the switch is held now: enough heartbeats in a row, the newest one new enough."""
        return self.count >= settings.beats_to_engage and not self.let_go(now_ns, settings)

    def let_go(self, now_ns: int, settings: GateSettings) -> bool:
        """Whether no heartbeat is new enough."""
        return self.last_ns is None or not 0 <= now_ns - self.last_ns <= settings.heartbeat_s * 1e9
