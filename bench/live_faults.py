"""What goes wrong in a live session, on purpose: how soon it is named, whether the skeleton continues, how soon it is over.

    python bench/live_faults.py [--only NAME ...] [--session examples/demo]

A simulated session is played at the pace of the clock, again and again; a camera, or the process of two, fails for some seconds.
Errors are of the 14 joints against the truth at output time. A table on stderr, one JSON object on stdout.
"""

import os
import signal
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from harness import DEMO, answer, arguments, errors, truth_of
from live_program import Program, loop_s

from posefuse.core.skeleton import PAPER14
from posefuse.realtime.capture import LOOP_PAUSE_S
from posefuse_ros.bags import read_detections, read_poses

_FAULTY = (sys.executable, str(Path(__file__).with_name("faulty_live.py")))
_BEFORE_S, _LEAST_S = 2.0, 3.0
# the person jumps back where the video begins again
_JUMP_S = 1.5


@dataclass(frozen=True)
class Case:
    """One thing that goes wrong.

    Attributes:
        name: of the row. state: how the monitor should call it; empty when nothing should be named.
        cameras: that are ill. start_s, end_s: when, after everything runs. last_s: when it is stopped.
        fault: as of `faulty_live`; ``kill`` ends the process of the cameras.
    """

    name: str
    state: str
    cameras: tuple[str, ...]
    start_s: float = 6.0
    end_s: float = 9.0
    last_s: float = 16.0
    fault: str = ""


CASES = (
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


def played(case: Case, recording: Path, session: Path) -> tuple[dict, Case]:
    """Figures of the session; and the case with the times, after the video showed its beginning, at which its fault was there."""
    faults = [f"{camera}={case.fault}@{case.start_s}-{case.end_s}" for camera in case.cameras if case.fault != "kill"]
    options = [*(part for fault in faults for part in ("--fault", fault)), "--", "live", str(session / "rig.toml")]
    options += ["--source", f"sim:{session}", "--record", str(recording), "--groups", "2", "--loop", str(loop_s(session))]
    live = Program([*_FAULTY, *options, "--json"])
    try:
        pid = int(live.wait_for(r"cam03 in process (\d+)")[1])
        live.wait_for(": ok")
        begun_s = time.monotonic()
        if case.fault == "kill":
            time.sleep(case.start_s)
            killed_ns = time.time_ns()
            os.kill(pid, signal.SIGKILL)
        time.sleep(max(0.0, case.last_s - (time.monotonic() - begun_s)))
        figures = live.stopped()
    finally:
        live.kill()
    if case.fault == "kill":
        killed_s = (killed_ns - figures["zero_ns"]) / 1e9
        case = replace(case, start_s=killed_s, end_s=killed_s)
    return figures, case


def figures_of(figures: dict, case: Case, recording: Path, session: Path) -> dict:
    """The row of a case."""
    zero_ns = figures["zero_ns"]
    events = [(e["t_s"], e["camera"], e["state"]) for e in figures["events"]]
    ill = [e for e in events if e[1] in case.cameras and e[0] >= case.start_s]
    named = [min((t for t, c, state in ill if c == camera and state == case.state), default=np.nan) for camera in case.cameras]
    back = [max((t for t, c, state in ill if c == camera and state == "ok"), default=np.nan) for camera in case.cameras]
    others = [e for e in events if e[1] not in case.cameras and e[0] >= case.start_s]
    blamed = {f"{c} {state}" for _, c, state in others if state not in ("ok", "opening")}
    times_s, errors_mm = errors_over_time(recording, session, zero_ns)
    before = (times_s >= case.start_s - _BEFORE_S) & (times_s < case.start_s)
    during = (times_s >= case.start_s) & (times_s < max(case.end_s, case.start_s + _LEAST_S))
    return {
        "case": case.name,
        "named": case.state,
        "named_s": float(np.max(np.array(named) - case.start_s)) if named else None,
        "back_s": float(np.max(np.array(back) - case.end_s)) if back else None,
        "unused_s": longest_gap_s(recording, case, zero_ns) if case.cameras else None,
        "blamed_wrongly": sorted(blamed),
        "before_mm": mean(errors_mm[before]),
        "during_mm": mean(errors_mm[during]),
        "shown_share": float(np.isfinite(errors_mm[during]).mean()) if during.any() else None,
    }


def mean(values_mm: np.ndarray) -> float | None:
    return float(np.nanmean(values_mm)) if np.isfinite(values_mm).any() else None


def longest_gap_s(recording: Path, case: Case, zero_ns: int) -> float:
    """Longest time after the fault began in which no view of one of its cameras was used."""
    gaps = []
    for camera in case.cameras:
        seen = [(view.t_ns - zero_ns) / 1e9 for view, _ in read_detections(recording) if view.camera == camera]
        times = np.array([t for t in seen if t >= case.start_s - 1])
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
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for i, case in enumerate(CASES):
            if not args.only or any(word in case.name for word in args.only):
                recording = Path(scratch) / f"{i}.mcap"
                rows.append(figures_of(*played(case, recording, args.session), recording, args.session))
    answer(args, {"Faults": rows})


if __name__ == "__main__":
    main()
