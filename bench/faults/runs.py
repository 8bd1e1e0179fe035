"""One run of one case or good session: kept in a file of its own, so that a long bench can stop, continue, and share its work."""

from __future__ import annotations

import json
import os
import re
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from .verdict import ACCEPTED, REFUSED, Answer, Case, GoodSession, verdict


@dataclass(frozen=True)
class Run:
    """One session of a case, or one good session.

    Attributes:
        of: the case or the good session. seed: same seed, same session.
    """

    of: Case | GoodSession
    seed: int

    @property
    def file(self) -> str:
        """Name of the file that keeps its answer."""
        return f"{re.sub(r'[^a-z0-9]+', '_', self.of.name.lower()).strip('_')}.{self.seed}.json"


@dataclass(frozen=True)
class Outcome:
    """The result of a run.

    Attributes:
        verdict: of a fault, one of `verdict.VERDICTS`; of a good session, accepted or refused. answer: with its words.
        cpu_s: processor time.
    """

    verdict: str
    answer: Answer
    cpu_s: float


def carry_out(run: Run) -> Outcome:
    """Make the session, calibrate, judge."""
    start = time.process_time()
    answer = run.of.run(run.seed)
    judged = verdict(run.of, answer) if isinstance(run.of, Case) else REFUSED if answer.refused else ACCEPTED
    return Outcome(judged, answer, time.process_time() - start)


def kept(folder: Path, run: Run) -> Outcome | None:
    """The outcome of an earlier time; judged again, so that a corrected regular expression needs no new run."""
    try:
        content = json.loads((folder / run.file).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    answer = Answer(**content["answer"])
    judged = verdict(run.of, answer) if isinstance(run.of, Case) else content["verdict"]
    return Outcome(judged, answer, content["cpu_s"])


def carry_out_once(folder: Path, run: Run) -> Outcome | None:
    """The outcome, from its file where there is one; None where another process is at it.

    A run that was broken off leaves an empty claim, which `give_up_claims` removes.
    """
    claim = folder / f"{run.file}.claim"
    if (found := kept(folder, run)) is not None:
        return found
    try:
        os.close(os.open(claim, os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        return None
    try:
        outcome = carry_out(run)
        temporary = folder / f"{run.file}.part"
        temporary.write_text(json.dumps(asdict(outcome)) + "\n", encoding="utf-8")
        temporary.replace(folder / run.file)
        return outcome
    finally:
        claim.unlink(missing_ok=True)


def give_up_claims(folder: Path, older_s: float) -> None:
    """Remove claims of processes that were killed."""
    for claim in folder.glob("*.claim"):
        if time.time() - claim.stat().st_mtime > older_s:
            claim.unlink(missing_ok=True)
