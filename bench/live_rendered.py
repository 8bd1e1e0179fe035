"""Live tracking of rendered people with the default network's own errors: how far the skeleton is off when it comes out.

    python bench/live_rendered.py --keep DIR [--bodies 2] [--seeds 1,2] [--rows walk idle] [--session DIR]

Four cameras of 640 x 480 at 30 frames/s look at bodies that no constant was fitted to: their seeds are drawn by chance at the
first run and kept in DIR, with the scenes. Views arrive 20 to 60 ms after their exposure (*late*), as in
a session of two cores; poses come out at 100 Hz, at joint centres, and are compared with the truth at their own time. *At once*
is the same without latency. NEES is the squared error in units of the stated covariance: 3 when it is honest. *Found* is
the share of the joints that came out. `--session` adds a rendered session, such as examples/demo. Means over bodies.
"""

from pathlib import Path

import numpy as np
from bodies import ARRIVE, MOVES, Trial, seeds_of, trial_session
from harness import OUT, Use, answer, arguments, medians


def measured(sessions: list[tuple[Path, int]]) -> dict[str, float]:
    """Means over sessions and their seeds."""
    found = {
        arrive: medians([Trial.of(session, arrive, seed).accuracy() for session, seed in sessions], np.mean) for arrive in ARRIVE
    }
    return {f"{name}, {arrive}": row[name] for arrive, row in found.items() for name in ("mean_mm", "nees", "found")}


def main() -> None:
    args = arguments(__doc__, keep=OUT / "scenes", bodies=2, seeds="", rows=dict.fromkeys(MOVES), session=Path)
    seeds, rows = seeds_of(args.keep, args.bodies, args.seeds), []
    for row in args.rows:
        rows.append({"motion": row, **measured([(trial_session(args.keep, row, seed, Use.REPORT), seed) for seed in seeds])})
    if args.session:
        rows.append({"motion": args.session.name, **measured([(args.session, 0)])})
    answer(args, {"Error at output time": rows}, seeds=seeds)


if __name__ == "__main__":
    main()
