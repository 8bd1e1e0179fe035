"""`posefuse report`: joint angles, gait, files for biomechanics tools and one page about a result."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from posefuse.cli.options.shared import Figures, Shown


def report(
    result: Annotated[Path, Parameter(metavar="RESULT")],
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    fit: Literal["none", "points", "rays"] = "points",
    title: Annotated[str | None, Parameter(metavar="TEXT")] = None,
    opensim: bool = False,
    opensim_model: Annotated[Path | None, Parameter(metavar="OSIM")] = None,
    terminal: Shown,
) -> Figures:
    """Compute joint angles of a result: one HTML page, and files for OpenSim, Visual3D, Mokka, Blender and spreadsheets.

    Args:
        result: Folder written by `posefuse track`, or the .mcap of `posefuse live --record`.
        out: Folder for the files (default DIR/biomechanics, or NAME_biomechanics for NAME.mcap).
        fit: Fit one skeleton of constant lengths to the 3D points, to the rays of all views, or not at all.
        title: Title of the page (default: Motion report).
        opensim: Run OpenSim's inverse kinematics too (extra: biomech).
        opensim_model: Scale your OpenSim model to each person and run inverse kinematics on it (extra: biomech).
    """
    from posefuse.evaluation.biomechanics import BiomechanicsSettings
    from posefuse.foundation.compiled import compiling
    from posefuse.pipeline.reading import read_result
    from posefuse.pipeline.reporting import report_folder, write_report_folder

    recording = read_result(result, terminal.warn, observed=fit == "rays")
    folder = out or report_folder(result)
    settings = BiomechanicsSettings(fit=fit, opensim=opensim, opensim_model=opensim_model)
    with compiling("joint angles", terminal.note), terminal.stages() as progress:
        made = write_report_folder(recording, result, folder, settings, title=title, progress=progress, warn=terminal.warn)
    names = [path.relative_to(folder).as_posix() for path in made]
    page = folder / "report.html"
    terminal.facts("Biomechanics", {"people": len(recording.poses.person_id), "files": ", ".join(names), "look at": str(page)})
    terminal.next(f"open {page} in a browser", "angles.csv and angles.mot in the same folder hold the numbers")
    return {"out": folder, "files": names, "people": len(recording.poses.person_id)}
