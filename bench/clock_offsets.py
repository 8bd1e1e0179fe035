"""Clocks of two machines from the person their cameras see: how far off the difference is found, over time.

    python bench/clock_offsets.py [SESSION ...] [--detector blazepose] [--runs 12]

The 2D poses of every frame of the sessions (simulated ones, of any motion) are made once; then they are played, again and
again as `--loop` does, with half of the cameras on a machine whose clock is 50 ms ahead, each run with other cameras, another
moment to begin, and as many frames lost at random as a machine with too little time gives up. Table on stderr, one JSON object on
stdout.
"""

import time
from itertools import combinations

import numpy as np
from harness import DEMO, answer, arguments, tracked

from posefuse.calibration.keypoints import limb_keypoints
from posefuse.core import Rig, ViewSequence
from posefuse.health.clock_finding import ClockFinder

OFFSET_S = 0.05
RATES_HZ = (30.0, 15.0, 8.0)
LOOKED_AT_S = (10.0, 20.0, 35.0, 60.0)
ASKED_S = 1.0


def run(rig: Rig, views: ViewSequence, rate_hz: float, number: int) -> tuple[list[float], float]:
    """Error of the difference in ms after each of `LOOKED_AT_S` (NaN while nothing is known), and CPU seconds per finding."""
    rng = np.random.default_rng([number, round(rate_hz)])
    halves = list(combinations(rig.names, len(rig) // 2))
    ahead = halves[number % len(halves)]
    finder, limbs = ClockFinder(rig), limb_keypoints(views.skeleton.keypoints)
    period_s = float(np.median(np.diff(views.t_ns))) / 1e9
    begin = int(rng.integers(len(views.t_ns)))
    found, asked_s, work_s, errors = {}, ASKED_S, [], {}
    for step in range(round(LOOKED_AT_S[-1] / period_s) + 2):
        now_s, i = step * period_s, (begin + step) % len(views.t_ns)
        for c, name in enumerate(rig.names):
            if rng.random() < rate_hz * period_s:
                late_s = OFFSET_S if name in ahead else 0.0
                xy, score = views.xy_img[i, 0, c][limbs], views.score[i, 0, c][limbs]
                finder.add(name, 10**15 + round((now_s + late_s) * 1e9), xy, score)
        if now_s >= asked_s:
            asked_s += ASKED_S
            begun_s = time.process_time()
            found = finder.find() or found
            work_s.append(time.process_time() - begun_s)
        for look_s in LOOKED_AT_S:
            if now_s >= look_s:
                errors.setdefault(look_s, error_ms(found, rig, ahead))
    return [errors[look_s] for look_s in LOOKED_AT_S], float(np.mean([s for s in work_s if s > 1e-3] or [0.0]))


def error_ms(found: dict[str, float], rig: Rig, ahead: tuple[str, ...]) -> float:
    """Of the machines' difference; NaN where a camera is not known yet."""
    mean = [np.mean([found.get(name, np.nan) for name in rig.names if (name in ahead) == side]) for side in (True, False)]
    return float(1000 * (mean[0] - mean[1] - OFFSET_S))


def main() -> None:
    args = arguments(__doc__, positional=("sessions",), sessions=(DEMO,), detector="blazepose", runs=12)
    rows = []
    for session in args.sessions:
        options = {"truth": session / "truth" / "truth.npz"} if args.detector == "oracle" else {}
        seen = tracked(session, detector={"name": args.detector, "options": options}, raw=True)
        for rate_hz in RATES_HZ:
            runs = [run(seen.rig, seen.views, rate_hz, number) for number in range(args.runs)]
            row = {"session": session.name, "frames/s": rate_hz}
            for look_s, off in zip(LOOKED_AT_S, np.abs([errors for errors, _ in runs]).T, strict=True):
                known = off[np.isfinite(off)]
                row[f"{look_s:g} s: known"] = f"{len(known)}/{len(off)}"
                row[f"median ms, {look_s:g} s"] = float(np.median(known)) if len(known) else None
                row[f"worst ms, {look_s:g} s"] = float(known.max()) if len(known) else None
            rows.append(row | {"ms per finding": 1000 * float(np.mean([work for _, work in runs]))})
    answer(args, {"Clock offsets": rows}, detector=args.detector, runs=args.runs)


if __name__ == "__main__":
    main()
