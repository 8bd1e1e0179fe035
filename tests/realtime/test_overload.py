"""Where the machine is too slow to watch the rig, that is said, and not that cameras were moved or are late."""

import numpy as np

from posefuse.core import CameraHealth
from posefuse.health.cameras import CameraState, Monitor
from posefuse.health.misalignment import CommonTimeSteps

S = 1_000_000_000
ILL = {"a": CameraHealth("moved", "a is off by 21 mm relative to the other cameras")}


def report_frames(monitor: Monitor, t_s: float, captured: int, used: int) -> None:
    state = CameraState(camera="a", state="running", text="", captured=captured, used=used, replaced=captured - used, missing=0)
    monitor.take_state(state, round(t_s * S))


def test_overload_is_reported_instead_of_a_finding() -> None:
    monitor = Monitor(("a", "b"))
    for t_s in range(1, 9):
        report_frames(monitor, t_s, 30 * t_s, 15 * t_s)
        monitor._watches["a"].seen_ns = t_s * S
    verdict = monitor.judge(8 * S, {}, ILL)["a"]
    assert verdict.state == "overload" and "only 50% of its frames are used" in verdict.text
    assert monitor.overloaded("a") and not monitor.overloaded("b")
    # as long as nothing seems to be wrong there is nothing to say
    assert monitor.judge(8 * S, {}, {})["a"].state == "ok"


def test_a_finding_stands_where_frames_are_used() -> None:
    monitor = Monitor(("a", "b"))
    for t_s in range(1, 9):
        report_frames(monitor, t_s, 30 * t_s, 28 * t_s)
        monitor._watches["a"].seen_ns = t_s * S
    assert monitor.judge(8 * S, {}, ILL)["a"] == ILL["a"]


def test_views_far_apart_are_not_read_between() -> None:
    for apart_s, there in ((0.1, True), (0.2, False)):
        time_steps, read = CommonTimeSteps(("a", "b")), []
        for i in range(60):
            for name in "ab":
                time_steps.add(name, round((i * apart_s + 0.03 * (name == "b")) * S), np.full((2, 2), float(i)), np.ones(2, bool))
            read += list(time_steps.ready())
        assert (len(read) > 10) == there
