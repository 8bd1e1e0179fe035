"""What `posefuse batch` does around the study: settings, progress, the table at the end."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.api.batch import FORMATS, batch
from posefuse.cli.command_options import BatchOptions
from posefuse.pipeline.batch.study import PAGE_FILE, TABLE_FILE
from posefuse.pipeline.config import read_config, settings_by_key

from .terminal import Terminal

_SHOWN = {
    "speed_m_s": "speed, m/s",
    "cadence_per_min": "steps/min",
    "stride_length_m": "stride, m",
    "median_sigma_mm": "sigma, mm",
}


def run_batch(study: Path, options: BatchOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Run the study; returns the figures of the tables. ``failed`` among them makes the exit code 1."""
    changes, formats = study_settings(options)
    with terminal.stages() as progress:
        done = batch(
            study,
            options.out,
            formats=formats,
            report=not options.no_report,
            jobs=options.jobs,
            scheduler=options.scheduler,
            settings=changes,
            replace=options.force,
            progress=progress,
        )
    rows = done.rows()
    shown = {name: title for name, title in _SHOWN.items() if any(name in row for row in rows)}
    columns = ["participant", "trial", "status", *shown.values()]
    terminal.table("Study", columns, [[row[name] for name in columns[:3]] + [row.get(name) for name in shown] for row in rows])
    if done.failed:
        terminal.warn(f"{len(done.failed)} of {len(rows)} trials failed; the reasons are above and in {done.out / PAGE_FILE}")
    terminal.next(f"open {done.out / PAGE_FILE} in a browser", f"the summary; {TABLE_FILE} in the same folder holds the numbers")
    return {"out": done.out, "trials": rows, "kept": done.kept, "failed": dict(done.failed)}


def study_settings(options: BatchOptions) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Settings of every trial by dotted key, and the outputs: those of the option, else of the settings file."""
    read_config(options.config, options.changes)  # everything is checked before any work
    changes = {**settings_by_key(options.config), **options.changes}
    return changes, tuple(changes.pop("outputs", FORMATS))
