"""Many trials: `posefuse.batch`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posefuse.core import Progress

from .progress import shown

if TYPE_CHECKING:
    from posefuse.pipeline.batch import Study

FORMATS = ("trc", "c3d", "csv")


def batch(
    study: str | Path,
    out: str | Path,
    *,
    formats: Sequence[str] = FORMATS,
    report: bool = True,
    jobs: int | None = None,
    scheduler: str | None = None,
    settings: Mapping[str, Any] | None = None,
    replace: bool = False,
    progress: Progress | bool | None = None,
) -> Study:
    """Track every session below a folder; a trial that fails is named, and the others are finished.

    Run it again to continue: complete trials are kept, failed and new ones are done.

    Args:
        study: folder with sessions below it, e.g. ``P01/walk1``; a calibration may lie with the session or above it.
        out: folder for the results: a result folder per trial, the table ``study.csv`` and the page ``study.html``.
        formats: outputs of each trial, see `posefuse plugins`.
        report: write joint angles, gait and the report of each trial.
        jobs: trials at once on this machine; None: as many as its cores and its free memory allow.
        scheduler: address of a Dask scheduler, e.g. ``tcp://host:8786``, to run the trials there (extra ``cluster``).
        settings: settings of every trial by dotted key, as in `track`.
        replace: make trials again that were completed with other settings or from other files.
        progress: True for bars on stderr, or a function (see `Progress`).

    Returns:
        The study: `Study.rows` is the table, `Study.failed` lists failures with reasons.

    Raises:
        InputError: no session below `study`, or no place for the results.
        ConfigError: a wrong setting or an unknown format.
        DependencyError: `scheduler` without the extra ``cluster``.

    Examples:
        >>> import posefuse as pf
        >>> study = pf.batch("STUDY", "RESULTS")  # doctest: +SKIP
        >>> study.failed  # doctest: +SKIP
        {}
    """
    from posefuse.pipeline.batch import run_study

    with shown(progress) as reported:
        return run_study(
            Path(study),
            Path(out),
            formats=tuple(formats),
            settings=dict(settings or {}),
            report=report,
            jobs=jobs,
            scheduler=scheduler,
            replace=replace,
            progress=reported,
        )
