"""Live tracking of rendered people with the default network's own errors: how far the skeleton is off when it comes out.

    PYTHONPATH=. python bench/live_rendered.py --keep DIR [--bodies 2] [--seeds 1,2] [--rows walk,idle] [--session DIR]

Four cameras of 640 x 480 at 30 frames/s look at bodies that no constant was fitted to: their seeds are drawn by chance at the
first run and kept in DIR, with the scenes and what the network saw in them. Views arrive 20 to 60 ms after their exposure, as in
a session of two cores; poses come out at 100 Hz, at joint centres, and are compared with the truth at their own time. *At once*
is the same without latency. NEES is the squared error in units of the stated covariance: 3 when it is honest. The last figure is
the share of the joints that came out. `--session` adds a rendered session, such as examples/demo. A table on stderr, one JSON
object on stdout.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from body_held_out import seeds_of
from fit_tracker import ARRIVE, Trial, arrivals_of, seen, seen_in, table_of
from rich.console import Console
from rich.table import Table

from posefuse.core import Recording, Truth

ROWS = ("idle", "walk", "reach", "squat", "turn", "screen", "false_arm")


def measured(recording: Recording, truth: Truth, seed: int) -> dict[str, tuple[float, float, float]]:
    """Error in mm, NEES and share of joints by way to arrive."""
    table = table_of(recording)
    trials = {arrive: Trial(recording, truth, table, arrivals_of(recording, arrive, seed)) for arrive in ARRIVE}
    return {arrive: trial.accuracy() for arrive, trial in trials.items()}


def show(found: dict[str, dict[str, tuple[float, float, float]]]) -> None:
    table = Table(title="error at output time, mm (NEES), share of the joints that came out", title_justify="left")
    for column in ("motion", *ARRIVE):
        table.add_column(column)
    for row, figures in found.items():
        table.add_row(row, *("{:.1f} ({:.1f}) {:.0f}%".format(*figures[arrive]) for arrive in ARRIVE))
    Console(stderr=True, width=140).print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path, required=True)
    parser.add_argument("--bodies", type=int, default=2)
    parser.add_argument("--seeds", default="", help="instead of those drawn by chance")
    parser.add_argument("--rows", default=",".join(ROWS))
    parser.add_argument("--session", type=Path)
    args = parser.parse_args()
    args.keep.mkdir(parents=True, exist_ok=True)
    seeds = seeds_of(args.keep, args.bodies, args.seeds)
    found = {}
    for row in filter(None, args.rows.split(",")):
        bodies = [measured(*seen(args.keep, row, seed), seed) for seed in seeds]
        found[row] = {arrive: tuple(np.mean([body[arrive] for body in bodies], axis=0).tolist()) for arrive in ARRIVE}
    if args.session:
        found[args.session.name] = measured(*seen_in(args.keep, args.session), seed=0)
    show(found)
    print(json.dumps({"seeds": seeds, "rows": found}, indent=2))


if __name__ == "__main__":
    main()
