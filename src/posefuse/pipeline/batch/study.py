"""A study from end to end: find its sessions, do what is not done yet, write the table."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import DiskFullError, InputError, Progress, silent
from posefuse.detection.build import fetch_networks
from posefuse.foundation.output_file import atomic_file, check_outside_inputs, earlier_kept, keep_copy, write_text
from posefuse.foundation.output_folder import check_replaceable, growing_folder
from posefuse.foundation.summary import Block, Heading, Note, Table
from posefuse.pipeline.writing import build_sinks

from .processes import default_jobs, outcomes_here, outcomes_on_cluster
from .tasks import Outcome, Task, Trial, completed, find_trials, stored_outcome

COMMAND = "batch"
TABLE_FILE = "study.csv"
_SHOWN = {
    "speed_m_s": "speed, m/s",
    "cadence_per_min": "steps/min",
    "stride_length_m": "stride, m",
    "median_sigma_mm": "sigma, mm",
}
_FIRST_COLUMNS = ("participant", "trial", "status", "reason", "seconds", "warnings")


@dataclass(frozen=True, kw_only=True)
class Study:
    """All trials of a study and what became of them.

    Attributes:
        out: folder with a result folder per trial, and the table ``study.csv``.
        trials: by name. outcomes: of these trials, in the same order. kept: names of trials that were complete before.
    """

    out: Path
    trials: tuple[Trial, ...]
    outcomes: tuple[Outcome, ...]
    kept: tuple[str, ...]

    @property
    def failed(self) -> Mapping[str, str]:
        """Why trials failed, by name."""
        return {one.name: one.reason for one in self.outcomes if one.reason}

    @property
    def table(self) -> Path:
        """The numbers of all trials."""
        return self.out / TABLE_FILE

    def summary(self) -> list[Block]:
        """The trials, and the reasons of those that failed, for people."""
        rows = self.rows()
        shown = {name: title for name, title in _SHOWN.items() if any(name in row for row in rows)}
        cells = [[*(row[name] for name in _FIRST_COLUMNS[:3]), *(row.get(name) for name in shown)] for row in rows]
        line = f"{len(self.failed)} of {len(rows)} trials failed; the reasons are above and in {self.table}"
        failed = [Note(line, warning=True)] if self.failed else []
        return [Heading("Study"), Table([*_FIRST_COLUMNS[:3], *shown.values()], cells), *failed]

    def rows(self) -> list[dict[str, Any]]:
        """The table: one row per trial."""
        return [
            {
                "participant": trial.participant,
                "trial": trial.label,
                "status": "failed" if outcome.reason else "complete",
                "reason": outcome.reason,
                "seconds": round(outcome.seconds, 1),
                "warnings": "; ".join(outcome.warnings),
                **outcome.figures,
            }
            for trial, outcome in zip(self.trials, self.outcomes, strict=True)
        ]


def run_study(
    study: Path,
    out: Path,
    *,
    formats: Sequence[str],
    settings: Mapping[str, Any],
    report: bool = True,
    jobs: int | None = None,
    scheduler: str | None = None,
    replace: bool = False,
    progress: Progress = silent,
) -> Study:
    """Track every session below a folder; trials that an earlier run completed in the same way are kept.

    Args:
        study: folder with sessions below it, e.g. ``P01/walk1``. out: results; new, empty, or of an earlier run.
        formats: outputs of each trial. settings: changes of every trial's settings by dotted key.
        jobs: trials at once on this machine; None: as many as fit. scheduler: address of a Dask scheduler to use instead.
        replace: do trials again that were completed in another way (other settings, other files).

    Returns:
        The study; failed trials are in it with their reason.

    Raises:
        InputError: no sessions, no place for the results, or results made in another way (without `replace`).
        ConfigError: a wrong setting or an unknown output. DependencyError: no Dask.
    """
    if jobs is not None and scheduler is not None:
        raise InputError(f"`jobs={jobs}`: the workers of `scheduler={scheduler}` limit how many trials run at once; leave it out")
    build_sinks(formats)
    trials = find_trials(study)
    check_outside_inputs(out, [study])
    folder = growing_folder(out, command=COMMAND, names=[TABLE_FILE, *(f"{trial.name}.json" for trial in trials)])
    changes = {"outputs": tuple(formats), **settings}
    tasks = {trial.name: Task(trial=trial, out=folder / trial.name, settings=changes, report=report) for trial in trials}
    outcomes = _complete(folder, tasks, replace)
    kept, to_do = tuple(sorted(outcomes)), [task for name, task in tasks.items() if name not in outcomes]
    for task in to_do:
        check_replaceable(task.out, command="track", replace=True)
    earlier = f", {len(kept)} of them complete from an earlier run" if kept else ""
    progress("trials", len(kept), len(tasks), f"{len(tasks)} trial{'s' * (len(tasks) > 1)}{earlier}")
    if to_do:
        # once and here: every process would do it for itself
        config = to_do[0].config
        build_sinks(config.outputs)
        fetch_networks(config.detector, progress)
    for outcome in _run(to_do, jobs, scheduler):
        outcomes[outcome.name] = outcome
        with _naming_what_is_kept():
            _write_outcome(folder, outcome)
        message = f"{outcome.name}: {'failed: ' + outcome.reason if outcome.reason else f'complete in {outcome.seconds:.0f} s'}"
        progress("trials", len(outcomes), len(tasks), message)
    # refused here because another run was making them, and complete by now
    outcomes |= _complete(folder, {name: tasks[name] for name, outcome in outcomes.items() if outcome.reason}, replace=True)
    result = Study(out=folder, trials=tuple(trials), outcomes=tuple(outcomes[name] for name in tasks), kept=kept)
    with _naming_what_is_kept():
        _write_table(result)
    return result


@contextmanager
def _naming_what_is_kept() -> Iterator[None]:
    try:
        yield
    except DiskFullError as error:
        raise DiskFullError(f"{error}; complete trials are kept, and the same command continues with the others") from None


def _run(tasks: Sequence[Task], jobs: int | None, scheduler: str | None) -> Iterator[Outcome]:
    if tasks and scheduler is not None:
        return outcomes_on_cluster(tasks, scheduler)
    return outcomes_here(tasks, jobs or default_jobs())


def _complete(out: Path, tasks: Mapping[str, Task], replace: bool) -> dict[str, Outcome]:
    """Outcomes of an earlier run that need not be made again, by name.

    Raises:
        InputError: complete ones that were made in another way, without `replace`.
    """
    found = {name: outcome for name, task in tasks.items() if (outcome := completed(task)) is not None}
    same = {name: outcome for name, outcome in found.items() if outcome.made_with == tasks[name].made_with}
    others = sorted(set(found) - set(same))
    if others and not replace:
        raise InputError(
            f"{out}: holds results of {', '.join(others[:3])}{', ...' if len(others) > 3 else ''} that were made with other "
            "settings, files or another version; `replace=True` makes them again, or choose another folder"
        )
    return same


def _write_outcome(folder: Path, outcome: Outcome) -> None:
    path = folder / f"{outcome.name}.json"
    if stored_outcome(path) is None:
        keep_copy(path)  # a file of this name that is not ours
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, outcome.to_json() + "\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def _write_table(study: Study) -> None:
    """Floats to six digits; what is not known is empty."""
    rows = study.rows()
    columns = dict.fromkeys([*_FIRST_COLUMNS, *(name for row in rows for name in row)])
    with earlier_kept(study.table), atomic_file(study.table) as new, new.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns, restval="")
        writer.writeheader()
        writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)


def _cell(value: Any) -> Any:
    if isinstance(value, float):
        return "" if np.isnan(value) else f"{value:.6g}"
    return value
