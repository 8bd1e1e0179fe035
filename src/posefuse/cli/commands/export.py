"""`posefuse export`: a result as files of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from posefuse.cli.options.shared import Figures, Shown


def export(
    result: Annotated[Path, Parameter(metavar="RESULT")],
    /,
    *,
    out: Annotated[Path, Parameter(metavar="DIR")],
    outputs: Annotated[str, Parameter(metavar="A,B,...")] = "trc,c3d,csv",
    session: Annotated[Path | None, Parameter(metavar="FOLDER")] = None,
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
    from posefuse.pipeline.session_images import nearby_session, session_of_recording
    from posefuse.pipeline.writing import export_recording

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
