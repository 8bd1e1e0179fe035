"""`posefuse view`, `report`, `export` and `compare`: what can be made of a result."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

import posefuse as pf
from posefuse.api.recording import needs_detections
from posefuse.foundation.summary import Facts, Heading

from .options import MOST_S, Figures, Shown, positive

Result = Annotated[Path, Parameter(metavar="RESULT")]
SessionFolder = Annotated[Path | None, Parameter(metavar="FOLDER")]


def view(result: Result, /, *, session: SessionFolder = None, terminal: Shown) -> Figures:
    """Show a result in the Rerun viewer (extra: viewer), until the viewer is closed.

    Args:
        result: Folder written by `posefuse track`, or the .mcap of `posefuse live --record`.
        session: Session the result was made from, for its images (default: a folder of its name near the result or here).
    """
    with terminal.stages() as progress:
        return {"viewed": pf.read(result).view(session=session, progress=progress)}


def report(
    result: Result,
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
    fit: Literal["none", "points"] = "points",
    title: Annotated[str | None, Parameter(metavar="TEXT")] = None,
    opensim_model: Annotated[Path | None, Parameter(metavar="OSIM")] = None,
    terminal: Shown,
) -> Figures:
    """Compute joint angles of a result: one HTML page, and files for OpenSim, Visual3D, Mokka, Blender and spreadsheets.

    Args:
        result: Folder written by `posefuse track`, or the .mcap of `posefuse live --record`.
        out: Folder for the files (default DIR/biomechanics, or NAME_biomechanics for NAME.mcap).
        fit: Fit one skeleton of constant lengths to the 3D points, or not at all.
        title: Title of the page (default: Motion report).
        opensim_model: Scale your OpenSim model to each person and run inverse kinematics on it (extra: biomech).
    """
    recording = pf.read(result, observed=False)
    with terminal.stages() as progress:
        made = recording.report(out, fit=fit, opensim_model=opensim_model, title=title, progress=progress)
    page = next(path for path in made if path.name == "report.html")
    names, people = [path.relative_to(page.parent).as_posix() for path in made], len(recording.poses.person_id)
    terminal.show([Heading("Biomechanics"), Facts({"people": people, "files": ", ".join(names), "look at": str(page)})])
    terminal.next(f"open {page} in a browser", "angles.csv and angles.mot in the same folder hold the numbers")
    return {"out": page.parent, "files": names, "people": people}


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
    names = [name for name in outputs.split(",") if name]
    recording = pf.read(result, observed=needs_detections(names))
    with terminal.stages() as progress:
        made = recording.export(out, names, session=session, progress=progress)
    files, people = [path.relative_to(out.resolve()).as_posix() for path in made.files], len(recording.poses.person_id)
    terminal.show([Heading("Export"), Facts({"people": people, "files": ", ".join(files), "in": str(out)})])
    return {"out": out, "files": files, "people": people, "failed": made.failed}


def compare(
    a: Path,
    b: Path,
    /,
    *,
    out: Annotated[Path | None, Parameter(metavar="DIR")] = None,
    person: Annotated[int | None, Parameter(metavar="ID")] = None,
    scale: bool = False,
    no_time: bool = False,
    no_space: bool = False,
    align_first: Annotated[float | None, Parameter(metavar="S"), positive(MOST_S)] = None,
    terminal: Shown,
) -> Figures:
    """Compare two recordings (posefuse result or .mcap, TRC, C3D, CSV): aligned in time and space, error per point, drift.

    Args:
        a: The reference: result folder, .mcap, .trc, .c3d or .csv; or a folder of posefuse simulate, whose truth is then
            compared by simulation time, without alignment.
        b: The recording to align with A.
        out: Write compare.html and compare.json there.
        person: Which person of files that hold several.
        scale: Estimate the scale of B, too.
        no_time: Do not align in time: both have the times of one clock.
        no_space: Do not align in space: both have the coordinates of one system.
        align_first: Align in space by the first S seconds only, so that drift shows.
    """
    if out is not None:
        from posefuse.foundation.output_file import check_outside_inputs
        from posefuse.foundation.output_folder import check_replaceable

        check_outside_inputs(out, (a, b))
        check_replaceable(out, command="compare", replace=True)
    found = pf.compare(
        a, b, person=person, align_time=not no_time, align_space=not no_space, scale=scale, align_first_s=align_first
    )
    terminal.show(found.summary())
    if out is None:
        terminal.next("the same with --out DIR", "a page with every point over time, and compare.json")
    else:
        page = found.save(out)
        terminal.note(f"written: {page}")
        terminal.next(f"open {page} in a browser", "every point over time, and the drift")
    return found.figures
