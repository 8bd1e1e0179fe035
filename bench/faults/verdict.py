"""What a case is, what posefuse answered to it, and what that answer is worth."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

# an accepted rig counts as right up to this
MOST_ERROR_MM, MOST_ERROR_DEG = 10.0, 0.1
RIGHT, OTHER, CORRECTED, SILENT = "right name", "other name", "corrected", "silent"
VERDICTS = (RIGHT, OTHER, CORRECTED, SILENT)
# the group of sessions without a fault, and what they get
GOOD, ACCEPTED, REFUSED = "good", "accepted", "wrongly refused"


@dataclass(frozen=True)
class Answer:
    """One run.

    Attributes:
        refused: no rig came out. words: the refusal, or the warnings and notes of a rig that came out.
        error_mm, error_deg: of the worst camera of the rig that came out, against the truth.
    """

    refused: bool
    words: str
    error_mm: float = 0.0
    error_deg: float = 0.0


@dataclass(frozen=True)
class Case:
    """One fault, or a good session.

    Attributes:
        name: in words. group: what is calibrated, or `GOOD`. cause: regular expression of the words that name the cause.
        run: seed -> answer. not_in_images: why no image can show it; empty where one can.
    """

    name: str
    group: str
    cause: str
    run: Callable[[int], Answer]
    not_in_images: str = ""


def verdict(case: Case, answer: Answer) -> str:
    """One of `VERDICTS`; of a good session `ACCEPTED` or `REFUSED`."""
    if case.group == GOOD:
        return REFUSED if answer.refused else ACCEPTED
    named = re.search(case.cause, answer.words) is not None
    if answer.refused:
        return RIGHT if named else OTHER
    if answer.error_mm <= MOST_ERROR_MM and answer.error_deg <= MOST_ERROR_DEG:
        return CORRECTED
    return RIGHT if named else SILENT
