"""The outputs of a session that has none."""

from posefuse.realtime.messages import SessionClock
from posefuse.realtime.outputs import OutputPlan, OutputProcess


class NoOutputs(OutputProcess):
    def __init__(self) -> None:
        super().__init__(OutputPlan(rig=None, clock=SessionClock.begin()))
