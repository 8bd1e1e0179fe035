"""Camera processes that die at the wrong moment."""

import os
import signal
import sys
import time
from types import SimpleNamespace

import pytest

from posefuse.core.skeleton import COCO17
from posefuse.foundation.channel import Channel
from posefuse.realtime import processes
from posefuse.realtime.messages import Ready


def ready_at_once(plan: object, channel: Channel, board: object) -> None:
    """A group without cameras: ready, then waiting for its end."""
    channel.send(Ready(0, COCO17, None))
    channel.wait(30.0)


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_a_process_that_dies_between_ready_and_begin_is_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "run_group", ready_at_once)
    groups = processes.Groups([SimpleNamespace(inputs=(), videos=None)], None)  # type: ignore[list-item, arg-type]
    try:
        member = groups._members[0]
        while member.marks is None:
            groups._hear_ready(member)
        os.kill(member.process.pid, signal.SIGKILL)
        member.process.join(10.0)
        groups.begin(time.monotonic_ns())
        assert "SIGKILL; starting again" in member.trouble
        assert member.again_at_s is not None
    finally:
        groups.stop()
