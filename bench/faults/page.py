"""The table of all cases, for docs/calibration_faults.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from .verdict import ACCEPTED, MOST_ERROR_DEG, MOST_ERROR_MM, REFUSED, VERDICTS, Answer, Case

_HEAD = f"""# Faults of calibrations, and what posefuse answers

Written by `make calibration-faults`. Every fault is constructed with a known truth, once per seed.

- *right name*: refused (or, for files, warned of) with the cause named. *other name*: refused, and another cause named.
- *corrected*: a rig came out within {MOST_ERROR_MM:g} mm and {MOST_ERROR_DEG:g} deg of the truth (a person: six times as much).
- *silent*: a wrong rig came out and nothing was said.
"""


def page(
    cases: Sequence[Case],
    found: Mapping[str, Sequence[tuple[str, Answer]]],
    accepted: Mapping[str, tuple[str, Answer]],
    seeds: Sequence[int],
    seconds: float,
) -> tuple[str, dict[str, float]]:
    """The page, and its figures."""
    told = [case for case in cases if not case.not_in_images]
    counts = Counter(verdict for case in told for verdict, _ in found[case.name])
    good = Counter(verdict for verdict, _ in accepted.values())
    runs = max(sum(counts.values()), 1)
    figures = {verdict: float(counts[verdict]) for verdict in VERDICTS}
    figures |= {ACCEPTED: float(good[ACCEPTED]), REFUSED: float(good[REFUSED]), "cpu_s": seconds}
    lines = [_HEAD, f"{len(told)} faults, seeds {', '.join(map(str, seeds))}, {seconds / 60:.0f} minutes of one core.", ""]
    lines += ["| " + " | ".join(VERDICTS) + f" | {len(accepted)} good sessions refused |", "|---" * (len(VERDICTS) + 1) + "|"]
    shares = " | ".join(f"{counts[v]} ({counts[v] / runs:.1%})" for v in VERDICTS)
    lines += [f"| {shares} | {good[REFUSED]} |", "", "| group | fault | " + " | ".join(VERDICTS) + " |", "|---" * 6 + "|"]
    for case in told:
        own = Counter(verdict for verdict, _ in found[case.name])
        lines.append(f"| {case.group} | {case.name} | " + " | ".join(str(own[v] or "") for v in VERDICTS) + " |")
    hidden = [case for case in cases if case.not_in_images]
    if hidden:
        lines += ["", "## What no image can show", ""]
        lines += [f"- {case.name}: {case.not_in_images}." for case in hidden]
    refused = [name for name, (verdict, _) in accepted.items() if verdict == REFUSED]
    worst = max((answer.error_mm for verdict, answer in accepted.values() if verdict == ACCEPTED), default=0.0)
    lines += ["", "## Good sessions", "", f"{good[ACCEPTED]} accepted, the worst of them {worst:.1f} mm off. Refused: "
              f"{', '.join(refused) or 'none'}."]  # fmt: skip
    return "\n".join(lines) + "\n", figures
