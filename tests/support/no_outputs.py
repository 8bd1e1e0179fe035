"""Stand-ins of a session: no outputs, outputs that keep what they are offered, and a tracker of one motionless person."""

from typing import Any

import built
import numpy as np

from posefuse.core import LiveMessage, LiveOutput, LivePose, Pose3D, Skeleton
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.messages import LivePlan, SessionClock
from posefuse.realtime.outputs import OutputProcess


class NoOutputs(OutputProcess):
    def __init__(self) -> None:
        super().__init__(LivePlan(rig=None, inputs=(), config=LiveConfig(), outputs={}), SessionClock.begin())


class KeptOutputs(NoOutputs):
    """Keeps all messages in `offered`, and hands them to one output at once."""

    def __init__(self, output: LiveOutput | None = None) -> None:
        super().__init__()
        self.offered: list[LiveMessage] = []
        self._output = output

    def offer(self, message: LiveMessage) -> None:
        self.offered.append(message)
        if self._output:
            self._output.take(message)

    def poses(self) -> list[Pose3D]:
        """Those among them."""
        return [message.pose for message in self.offered if isinstance(message, LivePose)]


class StillPerson:
    """A tracker of one person at (K, 3), known as well as stated."""

    def __init__(self, xyz: np.ndarray, skeleton: Skeleton, sigma_m: float = 0.01) -> None:
        self._known: dict[str, Any] = {"skeleton": skeleton, "cov": sigma_m**2 * np.eye(3)}
        self._xyz, self.health = xyz[None], dict[str, Any]()

    def at(self, t_ns: int) -> Pose3D:
        return built.pose(self._xyz, t_ns=t_ns, **self._known)

    looked_for = at

    def evidence(self, t_ns: int) -> dict[str, Any]:
        return {}

    def check(self) -> None:
        """Nothing can wait."""
