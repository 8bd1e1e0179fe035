"""`posefuse batch`: every session of a study."""

from __future__ import annotations

from pathlib import Path

from posefuse.cli.options.batch import BatchOptions
from posefuse.cli.options.shared import Figures, SettingsOptions, Shown


def batch(study: Path, /, *, options: BatchOptions, settings: SettingsOptions = SettingsOptions(), terminal: Shown) -> Figures:
    """Track every session below a folder (participant/trial), with one table and a summary page over participants.

    A trial that fails is named and the rest is finished. The same command continues where it was interrupted.

    Args:
        study: Folder with the sessions, e.g. STUDY/P01/walk1.
    """
    from posefuse.cli.batch import run_batch

    return run_batch(study, options, settings, terminal)
