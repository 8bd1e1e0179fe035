"""`posefuse view`, `report`, `export` and `compare`: what can be made of a result."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from posefuse.cli.command_options import CompareOptions
from posefuse.cli.options import Figures, Shown

Result = Annotated[Path, Parameter(metavar="RESULT")]
SessionFolder = Annotated[Path | None, Parameter(metavar="FOLDER")]


def view(result: Result, /, *, session: SessionFolder = None, terminal: Shown) -> Figures:
    """Show a result in the Rerun viewer (extra: viewer), until the viewer is closed.

    Args:
        result: Folder written by `posefuse track`, or the .mcap of `posefuse live --record`.
        session: Session the result was made from, for its images (default: a folder of its name near the result or here).
    """
    from posefuse.cli.viewing import view_result

    return {"viewed": view_result(result, session, terminal)}


def report(
    result: Result,
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
    from posefuse.pipeline.reports import report_folder, write_report_folder

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


def export(
    result: Result,
    /,
    *,
    out: Annotated[Path, Parameter(metavar="DIR")],
    outputs: Annotated[str, Parameter(metavar="A,B,...")] = "trc,c3d,csv",
    session: SessionFolder = None,
    terminal: Shown,
) -> Figures:
    """Write a result as files of other formats: TRC, C3D, CSV, MCAP, videos.

    Args:
        result: Folder written by `posefuse track`, or the .mcap of `posefuse live --record`.
        out: Folder for the files; the unchanged files of an earlier export are replaced.
        outputs: Which files to write; `posefuse plugins` lists them.
        session: Session the result was made from, for its images (default: a folder of its name near the result or here).
    """
    from posefuse.pipeline.reading import files_of_result, read_result
    from posefuse.pipeline.writing import export_recording, nearby_session, session_of_recording

    recording = read_result(result, terminal.warn)
    found = nearby_session(recording, result) if session is None else session_of_recording(recording, session)
    names, inputs = [name for name in outputs.split(",") if name], files_of_result(result)
    with terminal.stages() as progress:
        made, failed = export_recording(recording, out, names, found, replace=True, progress=progress, inputs=inputs)
    for name, reason in failed.items():
        terminal.warn(f"output {name}: not written ({reason})")
    files = [path.relative_to(out.resolve()).as_posix() for path in made]
    terminal.facts("Export", {"people": len(recording.poses.person_id), "files": ", ".join(files), "in": str(out)})
    return {"out": out, "files": files, "people": len(recording.poses.person_id), "failed": failed}


def compare(a: Path, b: Path, /, *, options: CompareOptions = CompareOptions(), terminal: Shown) -> Figures:
    """Compare two recordings (posefuse result or .mcap, TRC, C3D, CSV, MVNX): aligned in time and space, error per point, drift.

    Args:
        a: The reference: result folder, .mcap, .trc, .c3d, .csv or .mvnx; or a folder of posefuse simulate, whose truth is then
            compared by simulation time, without alignment.
        b: The recording to align with A.
    """
    from posefuse.cli.comparing import compare_files

    return compare_files(a, b, options, terminal)
