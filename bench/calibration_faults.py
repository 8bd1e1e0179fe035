"""Constructed faults of calibrations: is each refused by its right name, and is no good session refused?

Run: python bench/calibration_faults.py [--seeds 0 1 2] [--quick] [--only TEXT] [--page FILE] [--words]

Every case runs for every seed; the same seed makes the same session. `--quick` runs one seed of a few cases of each group.
`--words` prints what was said. JSON goes to stdout, the table to stderr and, on request, to a page.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import warnings
from collections import Counter
from pathlib import Path

# one core: many small solves gain nothing from more
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from faults import command_cases, file_cases, good_sessions, person_cases, prop_cases, verify_cases  # noqa: E402
from faults.page import page  # noqa: E402
from faults.verdict import ACCEPTED, REFUSED, Answer, Case, GoodSession, verdict  # noqa: E402

CASES = (*prop_cases.CASES, *person_cases.CASES, *verify_cases.CASES, *file_cases.CASES, *command_cases.CASES)
_QUICK_EACH, _QUICK_GOOD = 6, 10


def quick(cases: tuple[Case, ...]) -> tuple[Case, ...]:
    """Every so manieth case."""
    return cases[::_QUICK_EACH]


def run_case(case: Case, seeds: list[int], words: bool) -> list[tuple[str, Answer]]:
    """Verdict and answer of each seed."""
    answers = []
    for seed in seeds:
        answer = case.run(seed)
        answers.append((verdict(case, answer), answer))
        if words:
            said = answer.words[:600] if answer.refused or answer.words else "(nothing said)"
            print(f"    {seed}: {answers[-1][0]} {answer.error_mm:.1f} mm {answer.error_deg:.3f} deg: {said}", file=sys.stderr)
    return answers


def run_good(good: GoodSession, seed: int, words: bool) -> tuple[str, Answer]:
    """Whether a good session is accepted."""
    answer = good.run(seed)
    if words or answer.refused:
        print(f"    {good.name}: {answer.error_mm:.1f} mm {answer.error_deg:.3f} deg: {answer.words[:600]}", file=sys.stderr)
    return (REFUSED if answer.refused else ACCEPTED), answer


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", default="", help="cases and good sessions whose group or name contains this")
    parser.add_argument("--page", type=Path)
    parser.add_argument("--words", action="store_true")
    args = parser.parse_args()
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    start = time.process_time()
    seeds = args.seeds[:1] if args.quick else args.seeds
    cases = tuple(case for case in CASES if args.only in case.group or args.only in case.name)
    goods = tuple(good for good in good_sessions.SESSIONS if args.only in good.name or args.only == "good")
    cases, goods = (quick(cases), goods[::_QUICK_GOOD]) if args.quick else (cases, goods)
    found: dict[str, list[tuple[str, Answer]]] = {}
    for case in cases:
        found[case.name] = run_case(case, seeds, args.words)
        print(f"{case.group:9} {case.name}: {dict(Counter(v for v, _ in found[case.name]))}", file=sys.stderr, flush=True)
    accepted = {good.name: run_good(good, seeds[0], args.words) for good in goods}
    text, figures = page(cases, found, accepted, seeds, time.process_time() - start)
    print(text, file=sys.stderr)
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
