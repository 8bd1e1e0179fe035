"""What goes wrong in a live session, on purpose: how soon it is named, whether the skeleton continues, how soon it is over.

    python bench/live_faults.py [--only NAME ...] [--session examples/demo]

A simulated session is played at the pace of the clock, again and again. On one machine a camera (or the process of two) fails
for some seconds; on two, which are network namespaces and need root, the link between cameras and fusion does.
Errors are of the 14 joints against the truth at output time. A table on stderr, one JSON object on stdout.
"""

import os
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from harness import DEMO, answer, arguments, errors, note, truth_of
from live_program import Program, loop_s
from two_machines import TwoMachines, why_not

from posefuse.core.skeleton import PAPER14
from posefuse.realtime.capture import LOOP_PAUSE_S
from posefuse_ros.bags import read_detections, read_poses

_FAULTY = (sys.executable, str(Path(__file__).with_name("faulty_live.py")))
_BEFORE_S, _LEAST_S = 2.0, 3.0
# the person jumps back where the video begins again
_JUMP_S = 1.5
_DOMAIN = 50 + os.getpid() % 100


@dataclass(frozen=True)
class Case:
    """One thing that goes wrong.

    Attributes:
        name: of the row. state: how the monitor should call it; empty when nothing should be named.
        cameras: that are ill. start_s, end_s: when, after everything runs. last_s: when it is stopped.
        fault: as of `faulty_live`; ``kill`` ends the process of the cameras; empty is a matter of the link.
        loss, delay_s, cut: what the link does between start and end. ahead_s: what the clock of machine 1 is ahead.
    """

    name: str
    state: str
    cameras: tuple[str, ...]
    start_s: float = 6.0
    end_s: float = 9.0
    last_s: float = 16.0
    fault: str = ""
    loss: float = 0.0
    delay_s: float = 0.0
    cut: bool = False
    ahead_s: float = 0.0


ONE_MACHINE = (
    Case("nothing", "", (), fault="none"),
    Case("the same image", "frozen", ("cam01",), fault="freeze"),
    Case("clock an hour ahead", "clock", ("cam01",), fault="jump"),
    Case("1200 frames/s", "flood", ("cam01",), fault="flood"),
    Case("sends nothing", "silent", ("cam01",), fault="hang"),
    Case("unplugged", "lost", ("cam01",), fault="unplug"),
    Case("turned by 1.5 deg", "moved", ("cam01",), end_s=16.0, last_s=24.0, fault="bump"),
    Case("clock 50 ms ahead", "unsynchronised", ("cam01",), end_s=16.0, last_s=24.0, fault="skew"),
    Case("kill -9 of two cameras", "dead", ("cam02", "cam03"), end_s=6.0, last_s=20.0, fault="kill"),
)
_NEAR, _FAR = ("cam00", "cam01"), ("cam02", "cam03")
TWO_MACHINES = (
    Case("link: nothing", "", ()),
    Case("link: 5 % lost, 50 ms late", "", (), end_s=18.0, last_s=18.0, loss=0.05, delay_s=0.05),
    Case("link: cut for 10 s", "silent", _FAR, end_s=16.0, last_s=24.0, cut=True),
    Case("link: clock 50 ms ahead", "", (), start_s=25.0, end_s=35.0, last_s=35.0, ahead_s=0.05),
)


@dataclass(frozen=True)
class Ran:
    """What a case left: figures, when the video showed its beginning, and when the fault began and ended after that."""

    figures: dict
    zero_ns: int
    start_s: float
    end_s: float


def on_one_machine(case: Case, recording: Path, session: Path) -> Ran:
    faults = [f"{camera}={case.fault}@{case.start_s}-{case.end_s}" for camera in case.cameras if case.fault != "kill"]
    options = [*(part for fault in faults for part in ("--fault", fault)), "--", "live", str(session / "rig.toml")]
    options += ["--source", f"sim:{session}", "--record", str(recording), "--groups", "2", "--loop", str(loop_s(session))]
    live = Program([*_FAULTY, *options, "--json"])
    try:
        pid = int(live.wait_for(r"cam03 in process (\d+)")[1])
        live.wait_for(": ok")
        begun_s = time.monotonic()
        start_s = case.start_s
        if case.fault == "kill":
            time.sleep(case.start_s)
            start_ns = time.time_ns()
            os.kill(pid, signal.SIGKILL)
        time.sleep(max(0.0, case.last_s - (time.monotonic() - begun_s)))
        figures = live.stopped()
    finally:
        live.kill()
    zero_ns = figures["zero_ns"]
    if case.fault == "kill":
        start_s = (start_ns - zero_ns) / 1e9
    return Ran(figures, zero_ns, start_s, start_s if case.fault == "kill" else case.end_s)


def on_two_machines(case: Case, recording: Path, session: Path) -> Ran:
    """Machine 0 fuses and has two cameras, machine 1 has the other two."""
    zero_s = time.time()
    with TwoMachines(seed=1) as two:
        programs: list[Program] = []

        def start(machine: int, part: str, *options: str, zero_s: float = zero_s) -> Program:
            network = ["--domain", str(_DOMAIN), "--peer", two.addresses[1 - machine]]
            words = ["--zero", str(zero_s), "--", "node", part, str(session / "rig.toml"), *options, *network, "--json"]
            programs.append(Program([*_FAULTY, *words], lambda *command, **kept: two.start(machine, *command, **kept)))
            return programs[-1]

        def start_cameras(machine: int, cameras: Sequence[str], ahead_s: float) -> Program:
            sources = [part for camera in cameras for part in ("--source", f"{camera}=sim:{session}")]
            # stamps that are later by so much, as of a clock that is ahead
            return start(
                machine, "camera", "--name", f"m{machine}", *sources, "--loop", str(loop_s(session)), zero_s=zero_s + ahead_s
            )

        try:
            fusion = start(0, "fusion", "--record", str(recording))
            for cameras in (start_cameras(0, _NEAR, 0.0), start_cameras(1, _FAR, case.ahead_s)):
                cameras.wait_for("in process")
            fusion.wait_for("first view")
            begun_s = time.time()
            trouble(two, case, begun_s)
            figures = fusion.stopped()
        finally:
            for program in programs:
                program.kill()
    return Ran(figures, round(zero_s * 1e9), *(begun_s - zero_s + t for t in (case.start_s, case.end_s)))


def trouble(two: TwoMachines, case: Case, begun_s: float) -> None:
    """Let the link fail when it should."""
    wait_until(begun_s + case.start_s)
    two.loss, two.delay_s, two.cut = case.loss, case.delay_s, case.cut
    wait_until(begun_s + case.end_s)
    two.loss, two.delay_s, two.cut = 0.0, 0.0, False
    wait_until(begun_s + case.last_s)


def wait_until(unix_s: float) -> None:
    time.sleep(max(0.0, unix_s - time.time()))


def figures_of(case: Case, ran: Ran, recording: Path, session: Path) -> dict:
    """The row of a case."""
    events = [(e["t_s"] + (ran.figures["zero_ns"] - ran.zero_ns) / 1e9, e["camera"], e["state"]) for e in ran.figures["events"]]
    ill = [e for e in events if e[1] in case.cameras and e[0] >= ran.start_s]
    named = [min((t for t, c, state in ill if c == camera and state == case.state), default=np.nan) for camera in case.cameras]
    back = [max((t for t, c, state in ill if c == camera and state == "ok"), default=np.nan) for camera in case.cameras]
    others = [e for e in events if e[1] not in case.cameras and e[0] >= ran.start_s]
    blamed = {f"{c} {state}" for _, c, state in others if state not in ("ok", "opening")}
    times_s, errors_mm = errors_over_time(recording, session, ran.zero_ns)
    before = (times_s >= ran.start_s - _BEFORE_S) & (times_s < ran.start_s)
    during = (times_s >= ran.start_s) & (times_s < max(ran.end_s, ran.start_s + _LEAST_S))
    offsets = ran.figures.get("clock_offset_ms", {})
    return {
        "case": case.name,
        "named": case.state,
        "named_s": float(np.max(np.array(named) - ran.start_s)) if named else None,
        "back_s": float(np.max(np.array(back) - ran.end_s)) if back else None,
        "unused_s": longest_gap_s(recording, case.cameras, ran) if case.cameras else None,
        "blamed_wrongly": sorted(blamed),
        "before_mm": mean(errors_mm[before]),
        "during_mm": mean(errors_mm[during]),
        "shown_share": float(np.isfinite(errors_mm[during]).mean()) if during.any() else None,
        "clock_ms": clock_apart_ms(offsets) if offsets else None,
    }


def mean(values_mm: np.ndarray) -> float | None:
    return float(np.nanmean(values_mm)) if np.isfinite(values_mm).any() else None


def clock_apart_ms(offset_ms: dict[str, float]) -> float:
    """How much later the far machine's stamps are found to be."""
    far, near = ([np.nan if o is None else o for c, o in offset_ms.items() if (c in _FAR) == side] for side in (True, False))
    return float(np.mean(far) - np.mean(near))


def longest_gap_s(recording: Path, cameras: Sequence[str], ran: Ran) -> float:
    """Longest time after the fault began in which no view of one of its cameras was used."""
    gaps = []
    for camera in cameras:
        seen = [(view.t_ns - ran.zero_ns) / 1e9 for view, _ in read_detections(recording) if view.camera == camera]
        times = np.array([t for t in seen if t >= ran.start_s - 1])
        gaps.append(float(np.diff(times).max(initial=0.0)))
    return max(gaps)


def errors_over_time(recording: Path, session: Path, zero_ns: int) -> tuple[np.ndarray, np.ndarray]:
    """Times after zero in s, and mean error of the 14 joints in mm of the first person; NaN where no person is shown."""
    truth = truth_of(session)
    poses = [pose for pose, _ in read_poses(recording)]
    times_s = np.array([(pose.t_ns - zero_ns) / 1e9 for pose in poses])
    video_s = times_s % (loop_s(session) + LOOP_PAUSE_S)
    kept = (times_s > 0) & (video_s > _JUMP_S) & (video_s < truth.t_ns[-1] / 1e9)
    shown = [replace(poses[i], t_ns=round(video_s[i] * 1e9)) for i in np.flatnonzero(kept)]
    away = np.ma.masked_invalid(np.linalg.norm(errors(shown, truth, PAPER14.keypoints), axis=-1))
    return times_s[kept], 1000 * away.mean(axis=-1).filled(np.nan)


def main() -> None:
    args = arguments(__doc__, only=(str,), session=DEMO)
    reason = why_not()
    if reason:
        note(f"two machines left out: {reason}")
    cases = [(case, on_one_machine) for case in ONE_MACHINE] + [(case, on_two_machines) for case in TWO_MACHINES if not reason]
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for i, (case, way) in enumerate(cases):
            if not args.only or any(word in case.name for word in args.only):
                recording = Path(scratch) / f"{i}.mcap"
                rows.append(figures_of(case, way(case, recording, args.session), recording, args.session))
    answer(args, {"Faults": rows})


if __name__ == "__main__":
    main()
