"""Constructed faults of calibrations: is each refused by its right name, and is no good session refused?

Run: python bench/calibration_faults.py [--seeds 0 1 2] [--quick] [--only TEXT] [--words] [--keep DIR] [--write PAGE]

Every case runs for every seed; the same seed makes the same session. Good sessions run for the first seed only. `--quick` runs
one seed of a few cases of each group. `--words` prints the messages. Tables on stderr, one JSON object on stdout.

`--keep DIR` keeps each answer in a file; runs that are there are not run again. Several processes may share DIR, each with seeds
of its own.
"""

from __future__ import annotations

import json
import os
import re
import tempfile
import time
import warnings
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

# one core: many small solves gain nothing from more
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from faults import command_cases, file_cases, good_sessions, person_cases, prop_cases, verify_cases  # noqa: E402
from faults.verdict import ACCEPTED, GOOD, REFUSED, VERDICTS, Answer, Case, verdict  # noqa: E402
from harness import Row, answer, arguments, note  # noqa: E402

CASES = (*prop_cases.CASES, *person_cases.CASES, *verify_cases.CASES, *file_cases.CASES, *command_cases.CASES)
_QUICK_EACH, _QUICK_GOOD = 6, 10


@dataclass(frozen=True)
class Run:
    """One session of a case and its answer; cpu_s: processor time."""

    case: Case
    answer: Answer
    cpu_s: float

    @property
    def verdict(self) -> str:
        """Judged now, so that a corrected regular expression needs no new run."""
        return verdict(self.case, self.answer)


def carried_out(case: Case, seed: int, folder: Path) -> Run:
    """Make the session, calibrate, and keep the answer; or the run that is kept."""
    file = folder / f"{re.sub(r'[^a-z0-9]+', '_', case.name.lower()).strip('_')}.{seed}.json"
    if file.is_file():
        content = json.loads(file.read_text(encoding="utf-8"))
        return Run(case, Answer(**content["answer"]), content["cpu_s"])
    start = time.process_time()
    run = Run(case, case.run(seed), time.process_time() - start)
    temporary = file.with_suffix(".part")
    temporary.write_text(json.dumps({"answer": asdict(run.answer), "cpu_s": run.cpu_s}) + "\n", encoding="utf-8")
    temporary.replace(file)
    return run


def chosen(only: str, seeds: list[int], quick: bool) -> list[tuple[Case, int]]:
    """Faults seed by seed, and good sessions, of the first seed only, after its faults."""
    cases = [case for case in CASES if only in case.group or only in case.name]
    goods = [good for good in good_sessions.SESSIONS if only in good.name or only == GOOD]
    if quick:
        cases, goods, seeds = cases[::_QUICK_EACH], goods[::_QUICK_GOOD], seeds[:1]
    first = [(case, seeds[0]) for case in (*cases, *goods)]
    return first + [(case, seed) for seed in seeds[1:] for case in cases]


def tables(runs: list[Run]) -> dict[str, list[Row]]:
    """Of the page."""
    shown = [run for run in runs if run.case.group != GOOD and not run.case.not_in_images]
    counts, good = Counter(run.verdict for run in shown), [run for run in runs if run.case.group == GOOD]
    refused = [run.case.name for run in good if run.verdict == REFUSED]
    shares = {one: f"{counts[one]} ({counts[one] / max(len(shown), 1):.1%})" for one in VERDICTS}
    faults = []
    for case in dict.fromkeys(run.case for run in shown):
        count = Counter(run.verdict for run in shown if run.case == case)
        faults.append({"group": case.group, "fault": case.name, **{one: count[one] or None for one in VERDICTS}})
    hidden = dict.fromkeys(run.case for run in runs if run.case.not_in_images)
    worst_mm = max((run.answer.error_mm for run in good if run.verdict == ACCEPTED), default=0.0)
    goods = {"good sessions": len(good), "refused": refused, "the worst of the others, mm (a person's counts a sixth)": worst_mm}
    return {
        "Sessions": [{"faults": len(faults), "sessions": len(shown), **shares, "good sessions refused": len(refused)}],
        "Faults": faults,
        "What no image can show": [{"fault": case.name, "why": case.not_in_images} for case in hidden],
        "Good sessions": [goods] if good else [],
    }


def main() -> None:
    args = arguments(__doc__, seeds=(0, 1, 2), quick=False, only="", words=False, keep=Path)
    warnings.filterwarnings("ignore", category=RuntimeWarning)
    runs = []
    with tempfile.TemporaryDirectory() as own:
        folder = args.keep or Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        for case, seed in chosen(args.only, args.seeds, args.quick):
            runs.append(run := carried_out(case, seed, folder))
            said = f" {run.answer.error_mm:.1f} mm {run.answer.error_deg:.3f} deg: {run.answer.words[:600]}" if args.words else ""
            note(f"{case.group:9} {case.name} [{seed}, {run.cpu_s:.0f} s]: {run.verdict}{said}")
    answer(args, {title: rows for title, rows in tables(runs).items() if rows}, cpu_s=sum(run.cpu_s for run in runs))


if __name__ == "__main__":
    main()
