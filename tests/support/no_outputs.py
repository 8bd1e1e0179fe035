"""The outputs of a session that has none."""

from posefuse.realtime.clock import SessionClock
from posefuse.realtime.output_plan import OutputPlan
from posefuse.realtime.outputs import OutputProcess


class NoOutputs(OutputProcess):
    def __init__(self) -> None:
        super().__init__(OutputPlan(rig=None, clock=SessionClock.begin()))
