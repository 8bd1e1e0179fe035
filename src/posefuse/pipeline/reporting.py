"""The folder of a report next to the result that it is about."""

from __future__ import annotations

from pathlib import Path

from posefuse.core import Progress, Recording, silent
from posefuse.evaluation.biomechanics import BiomechanicsSettings, write_biomechanics
from posefuse.evaluation.report import TITLE
from posefuse.foundation.output_folder import output_folder

from .reading import files_of_result, is_live

FOLDER, PAGE_FILE = "biomechanics", "report.html"
# of all files together, measured on the bundled clip
_BYTES_PER_STEP_AND_PERSON = 6_000


def report_folder(result: Path) -> Path:
    """Where the report of a result lies unless asked otherwise: RESULT/biomechanics, or NAME_biomechanics for NAME.mcap."""
    return result.with_name(f"{result.stem}_{FOLDER}") if is_live(result) else result / FOLDER


def write_report_folder(
    recording: Recording,
    result: Path | None,
    folder: Path,
    settings: BiomechanicsSettings | None = None,
    *,
    title: str | None = None,
    progress: Progress = silent,
) -> list[Path]:
    """Write angles, gait, files for other programs and the page, an earlier report is moved aside; returns the files.

    Args:
        recording: what was read from `result`; None where it is in memory only.

    Raises:
        InputError: the folder holds anything else, or there is no one to report on.
    """
    size = len(recording.poses) * len(recording.poses.person_id) * _BYTES_PER_STEP_AND_PERSON
    inputs = [] if result is None else files_of_result(result)
    with output_folder(folder, command="report", inputs=inputs, replace=True, estimated_bytes=size) as place:
        made = write_biomechanics(recording, place.folder, settings, title=title or TITLE, progress=progress)
        relative = [path.relative_to(place.folder) for path in made]
    return [folder / path for path in relative]
