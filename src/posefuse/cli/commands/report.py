"""`posefuse report`: joint angles, gait, files for biomechanics tools and one page about a result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from posefuse.cli.options.shared import Figures, Shown

FOLDER = "biomechanics"
# of all files together, measured on the bundled clip
_BYTES_PER_STEP_AND_PERSON = 6_000


def report(
    result: Annotated[Path, Parameter(metavar="DIR")],
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    fit: Literal["none", "points", "rays"] = "points",
    title: Annotated[str | None, Parameter(metavar="TEXT")] = None,
    opensim: bool = False,
    terminal: Shown,
) -> Figures:
    """Compute joint angles of a result: one HTML page, and files for OpenSim, Visual3D, Mokka, Blender and spreadsheets.

    Args:
        result: Folder written by `posefuse track`, or the .mcap of `posefuse live --record`.
        out: Folder for the files (default DIR/biomechanics, or NAME_biomechanics for NAME.mcap).
        fit: Fit one skeleton of constant lengths to the 3D points, to the rays of all views, or not at all.
        title: Title of the page (default: Motion report).
        opensim: Run OpenSim's inverse kinematics too (extra: biomech).
    """
    from posefuse.evaluation.biomechanics import BiomechanicsSettings, write_biomechanics
    from posefuse.evaluation.report import TITLE
    from posefuse.foundation.compiled import compiling
    from posefuse.foundation.output_folder import output_folder
    from posefuse.pipeline.reading import files_of_result, is_live, read_result

    recording = read_result(result, terminal.warn)
    folder = out or (result.with_name(f"{result.stem}_{FOLDER}") if is_live(result) else result / FOLDER)
    inputs = files_of_result(result)
    settings = BiomechanicsSettings(fit=fit, opensim=opensim)
    size = len(recording.poses) * len(recording.poses.person_id) * _BYTES_PER_STEP_AND_PERSON
    # its own unchanged files can be made again at any time: replaced without --force
    with (
        output_folder(folder, command="report", inputs=inputs, replace=True, estimated_bytes=size, warn=terminal.warn) as place,
        compiling("joint angles", terminal.note),
        terminal.stages() as progress,
    ):
        made = write_biomechanics(recording, place.folder, settings, title=title or TITLE, progress=progress)
        names = [path.relative_to(place.folder).as_posix() for path in made]
    page = folder / "report.html"
    terminal.facts("Biomechanics", {"people": len(recording.poses.person_id), "files": ", ".join(names), "look at": str(page)})
    terminal.next(f"open {page} in a browser", "angles.csv and angles.mot in the same folder hold the numbers")
    return {"out": folder, "files": names, "people": len(recording.poses.person_id)}
