"""The table of all cases, for docs/calibration_faults.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from .runs import Outcome
from .verdict import ACCEPTED, MOST_ERROR_DEG, MOST_ERROR_MM, REFUSED, VERDICTS, Case, GoodSession

_HEAD = f"""# Faults of calibrations, and what posefuse answers

Written by `make calibration-faults`. Every fault is constructed with a known truth, once per seed.

- *right name*: refused (or, for files, warned of) with the cause named. *other name*: refused, and another cause named.
- *corrected*: a rig came out within {MOST_ERROR_MM:g} mm and {MOST_ERROR_DEG:g} deg of the truth (a person: six times as much).
- *silent*: a wrong rig was the result, without a message.
"""

Found = Sequence[tuple[Case, Outcome]]


def page(
    faults: Found, goods: Sequence[tuple[GoodSession, Outcome]], seeds: Sequence[int], not_run: int = 0
) -> tuple[str, dict[str, float]]:
    """The page, and its figures; `not_run`: sessions that a run with a time limit left out."""
    shown = [(case, outcome) for case, outcome in faults if not case.not_in_images]
    counts = Counter(outcome.verdict for _, outcome in shown)
    good = Counter(outcome.verdict for _, outcome in goods)
    seconds = sum(outcome.cpu_s for _, outcome in (*faults, *goods))
    figures = {verdict: float(counts[verdict]) for verdict in VERDICTS}
    figures |= {ACCEPTED: float(good[ACCEPTED]), REFUSED: float(good[REFUSED]), "cpu_s": seconds}
    names = list(dict.fromkeys(case.name for case, _ in shown))
    lines = [_HEAD, f"{len(names)} faults, {len(shown)} sessions, seeds {', '.join(map(str, seeds))}, {seconds / 60:.0f} minutes"
             " of one core.", ""]  # fmt: skip
    lines += [f"**Not complete: {not_run} sessions, good ones included, were not run.**", ""] if not_run else []
    lines += ["| " + " | ".join(VERDICTS) + f" | {len(goods)} good sessions refused |", "|---" * (len(VERDICTS) + 1) + "|"]
    shares = " | ".join(f"{counts[v]} ({counts[v] / max(len(shown), 1):.1%})" for v in VERDICTS)
    lines += [f"| {shares} | {good[REFUSED]} |", "", "| group | fault | " + " | ".join(VERDICTS) + " |", "|---" * 6 + "|"]
    lines += [_row(name, shown) for name in names]
    return "\n".join([*lines, *_hidden(faults), *_good(goods)]) + "\n", figures


def _row(name: str, shown: Found) -> str:
    own = [(case, outcome) for case, outcome in shown if case.name == name]
    count = Counter(outcome.verdict for _, outcome in own)
    return f"| {own[0][0].group} | {name} | " + " | ".join(str(count[v] or "") for v in VERDICTS) + " |"


def _hidden(faults: Found) -> list[str]:
    reasons = {case.name: case.not_in_images for case, _ in faults if case.not_in_images}
    return ["", "## What no image can show", "", *(f"- {name}: {why}." for name, why in reasons.items())] if reasons else []


def _good(goods: Sequence[tuple[GoodSession, Outcome]]) -> list[str]:
    if not goods:
        return ["", "## Good sessions", "", "Not run."]
    refused = [good.name for good, outcome in goods if outcome.verdict == REFUSED]
    accepted = [outcome for _, outcome in goods if outcome.verdict == ACCEPTED]
    worst = max((outcome.answer.error_mm for outcome in accepted), default=0.0)
    counts = f"{len(accepted)} accepted, the worst of them {worst:.1f} mm off (a person's counts a sixth)."
    return ["", "## Good sessions", "", f"{counts} Refused: {', '.join(refused) or 'none'}."]
