"""One run of one case or good session: kept in a file of its own, so that a long bench can stop and continue."""

from __future__ import annotations

import json
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


def kept(folder: Path, run: Run) -> Outcome | None:
    """The outcome of an earlier time; judged again, so that a corrected regular expression needs no new run."""
    try:
        content = json.loads((folder / run.file).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    answer = Answer(**content["answer"])
    judged = verdict(run.of, answer) if isinstance(run.of, Case) else content["verdict"]
    return Outcome(judged, answer, content["cpu_s"])


def carry_out(folder: Path, run: Run) -> Outcome:
    """Make the session, calibrate, judge, and keep it; or the outcome that is kept."""
    if (found := kept(folder, run)) is not None:
        return found
    start = time.process_time()
    answer = run.of.run(run.seed)
    judged = verdict(run.of, answer) if isinstance(run.of, Case) else REFUSED if answer.refused else ACCEPTED
    outcome = Outcome(judged, answer, time.process_time() - start)
    temporary = folder / f"{run.file}.part"
    temporary.write_text(json.dumps(asdict(outcome)) + "\n", encoding="utf-8")
    temporary.replace(folder / run.file)
    return outcome
