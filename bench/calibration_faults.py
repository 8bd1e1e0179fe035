"""Constructed faults of calibrations: is each refused by its right name, and is no good session refused?

Run: python bench/calibration_faults.py [--seeds 0 1 2] [--quick] [--only TEXT] [--page FILE] [--words] [--keep DIR [--for-s S]]

Every case runs for every seed; the same seed makes the same session. `--quick` runs one seed of a few cases of each group.
`--words` prints the messages. JSON goes to stdout, the table to stderr and, on request, to a page.

`--keep DIR` keeps each answer in a file; runs that are there are not run again. Several processes may share DIR, each with seeds
of its own. `--for-s` begins no run after so many seconds, and writes the page of what is there.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
import warnings
from pathlib import Path

# one core: many small solves gain nothing from more
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from faults import command_cases, file_cases, good_sessions, person_cases, prop_cases, verify_cases  # noqa: E402
from faults.page import page  # noqa: E402
from faults.runs import Outcome, Run, carry_out, kept  # noqa: E402
from faults.verdict import Case, GoodSession  # noqa: E402
from harness import arguments, note  # noqa: E402

CASES = (*prop_cases.CASES, *person_cases.CASES, *verify_cases.CASES, *file_cases.CASES, *command_cases.CASES)
_QUICK_EACH, _QUICK_GOOD = 6, 10


def chosen_runs(only: str, seeds: list[int], quick: bool) -> list[Run]:
    """Faults seed by seed, and good sessions, of the first seed only, after its faults."""
    cases = [case for case in CASES if only in case.group or only in case.name]
    goods = [good for good in good_sessions.SESSIONS if only in good.name or only == "good"]
    if quick:
        cases, goods, seeds = cases[::_QUICK_EACH], goods[::_QUICK_GOOD], seeds[:1]
    first = [Run(case, seeds[0]) for case in cases] + [Run(good, seeds[0]) for good in goods]
    return first + [Run(case, seed) for seed in seeds[1:] for case in cases]


def show(run: Run, outcome: Outcome, words: bool) -> None:
    """One line, with the messages on request."""
    of, answer = run.of, outcome.answer
    group = of.group if isinstance(of, Case) else "good"
    said = f" {answer.error_mm:.1f} mm {answer.error_deg:.3f} deg: {answer.words[:600]}" if words else ""
    note(f"{group:9} {of.name} [{run.seed}, {outcome.cpu_s:.0f} s]: {outcome.verdict}{said}")


def main() -> None:
    args = arguments(
        __doc__, seeds=(0, 1, 2), quick=False, only="", page=Path, words=False, keep=Path, for_s=float("inf")
    )  # fmt: skip
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    with tempfile.TemporaryDirectory() as own:
        folder = args.keep or Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        found: list[tuple[Run, Outcome]] = []
        begin = time.monotonic()
        runs = chosen_runs(args.only, args.seeds, args.quick)
        for run in runs:
            late = time.monotonic() - begin > args.for_s
            outcome = kept(folder, run) if late else carry_out(folder, run)
            if outcome is not None:
                found.append((run, outcome))
                show(run, outcome, args.words)
    text, figures = page(
        [(run.of, outcome) for run, outcome in found if isinstance(run.of, Case)],
        [(run.of, outcome) for run, outcome in found if isinstance(run.of, GoodSession)],
        args.seeds,
        len(runs) - len(found),
    )
    note(text)
    if args.page:
        args.page.write_text(text, encoding="utf-8")
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
