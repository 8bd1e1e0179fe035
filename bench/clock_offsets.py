"""Clocks of two machines from the person their cameras see: how far off the difference is found, over time.

    python bench/clock_offsets.py SESSION... [--detector blazepose] [--runs 12]

The 2D poses of every frame of the sessions (simulated ones, of any motion) are made once; then they are played, again and
again as `--loop` does, with half of the cameras on a machine whose clock is 50 ms ahead, each run with other cameras, another
moment to begin, and as many frames lost at random as a machine with too little time gives up. Table on stderr, one JSON object on
stdout.
"""

import argparse
import json
import time
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from posefuse.calibration.keypoints import limb_keypoints
from posefuse.core import Rig, ViewSequence
from posefuse.detection.build import DetectorChoice
from posefuse.health.clock_finding import ClockFinder
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.run import track_session
from posefuse.pipeline.session import find_session

OFFSET_S = 0.05
RATES_HZ = (30.0, 15.0, 8.0)
LOOKED_AT_S = (10.0, 20.0, 35.0, 60.0)
ASKED_S = 1.0


def views_of_session(session: Path, detector: DetectorChoice) -> tuple[Rig, ViewSequence]:
    """2D poses of every frame, as the pipeline for recordings has them."""
    config = replace(TrackConfig(), detector=detector, outputs={}, raw=True)
    done = track_session(find_session(session, config), config, StageClock(), lambda *_: None, lambda _: None, lambda _: None)
    return done.recording.rig, done.recording.views


def run(rig: Rig, views: ViewSequence, rate_hz: float, number: int) -> tuple[dict[float, float], float]:
    """Error of the difference in ms after each of `LOOKED_AT_S` (NaN while nothing is known), and CPU seconds per finding."""
    rng = np.random.default_rng([number, round(rate_hz)])
    halves = list(combinations(rig.names, len(rig) // 2))
    ahead = halves[number % len(halves)]
    finder, limbs = ClockFinder(rig), limb_keypoints(views.skeleton.keypoints)
    period_s = float(np.median(np.diff(views.t_ns))) / 1e9
    chance = rate_hz * period_s
    begin = int(rng.integers(len(views.t_ns)))
    found, asked_s, work_s, errors = {}, ASKED_S, [], {}
    for step in range(round(LOOKED_AT_S[-1] / period_s) + 2):
        now_s, i = step * period_s, (begin + step) % len(views.t_ns)
        for c, name in enumerate(rig.names):
            if rng.random() < chance:
                late_s = OFFSET_S if name in ahead else 0.0
                xy, score = views.xy_img[i, 0, c][limbs], views.score[i, 0, c][limbs]
                finder.add(name, 10**15 + round((now_s + late_s) * 1e9), xy, score)
        if now_s >= asked_s:
            asked_s += ASKED_S
            begun_s = time.process_time()
            found = finder.find() or found
            work_s.append(time.process_time() - begun_s)
        for look_s in LOOKED_AT_S:
            if now_s >= look_s and look_s not in errors:
                errors[look_s] = error_ms(found, rig, ahead)
    return errors, float(np.mean([s for s in work_s if s > 1e-3] or [0.0]))


def error_ms(found: dict[str, float], rig: Rig, ahead: tuple[str, ...]) -> float:
    """Of the machines' difference; NaN where a camera is not known yet."""
    mean = [np.mean([found.get(name, np.nan) for name in rig.names if (name in ahead) == side]) for side in (True, False)]
    return float(1000 * (mean[0] - mean[1] - OFFSET_S))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sessions", type=Path, nargs="+")
    parser.add_argument("--detector", default="blazepose")
    parser.add_argument("--runs", type=int, default=12)
    args = parser.parse_args()
    rows = []
    for session in args.sessions:
        options = {"truth": session / "truth" / "truth.npz"} if args.detector == "oracle" else {}
        rig, views = views_of_session(session, DetectorChoice(name=args.detector, options=options))
        for rate_hz in RATES_HZ:
            runs = [run(rig, views, rate_hz, number) for number in range(args.runs)]
            row = {"session": session.name, "frames/s": rate_hz}
            for look_s in LOOKED_AT_S:
                off = np.abs([errors[look_s] for errors, _ in runs])
                known = off[np.isfinite(off)]
                row[f"{look_s:g} s: known"] = f"{len(known)}/{len(off)}"
                row["median ms, " + f"{look_s:g} s"] = float(np.median(known)) if len(known) else None
                row["worst ms, " + f"{look_s:g} s"] = float(known.max()) if len(known) else None
            rows.append(row | {"ms per finding": 1000 * float(np.mean([work for _, work in runs]))})
    table = Table(*rows[0])
    for row in rows:
        table.add_row(*(f"{value:.1f}" if isinstance(value, float) else str(value) for value in row.values()))
    Console(stderr=True, width=220).print(table)
    print(json.dumps({"detector": args.detector, "runs": args.runs, "rows": rows}, indent=2))


if __name__ == "__main__":
    main()
