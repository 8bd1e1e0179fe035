"""Figures of teleoperation: `python bench/teleoperation.py STEP`, steps below; docs/explanation of each in docs/teleoperation.md.

faults    random fault sequences through mapping, gate, link and limits; breaches
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections import Counter

import numpy as np


def faults(first: int, count: int, workers: int) -> int:
    """Sequences `first` to `first + count - 1`; prints breaches by kind. Returns how many there were."""
    from posefuse.teleoperation.rehearsal.faults import run_many

    begun_s = time.monotonic()
    chunks = [(int(part[0]), len(part)) for part in np.array_split(np.arange(first, first + count), max(1, count // 500))]
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        done = pool.starmap(run_many, chunks, chunksize=1)
    breaches = [breach for found, _ in done for breach in found]
    moved = sum(went for _, went in done)
    kinds = dict(Counter(breach.what.split()[0] for breach in breaches))
    seconds = time.monotonic() - begun_s
    print(f"fault sequences {first} to {first + count - 1}: {len(breaches)} breaches {kinds}; moved in {moved}; {seconds:.0f} s")
    for breach in breaches[:10]:
        print(f"  sequence {breach.sequence} at {breach.t_s:.2f} s: {breach.what}")
    return len(breaches)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    steps = parser.add_subparsers(dest="step", required=True)
    fault = steps.add_parser("faults")
    fault.add_argument("--first", type=int, default=0)
    fault.add_argument("--count", type=int, default=100_000)
    fault.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    return int(faults(options.first, options.count, options.workers) > 0)


if __name__ == "__main__":
    sys.exit(main())
