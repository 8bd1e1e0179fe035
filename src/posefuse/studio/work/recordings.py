"""What is made of recordings: each takes arguments with names in the workspace, and gives JSON values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import posefuse as pf
from posefuse.studio.workspace import StudioWorkspace

Arguments = Mapping[str, Any]
Result = Mapping[str, Any]


def report_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """The report of ``result``: angles, gait, files for other programs, one page."""
    from posefuse.pipeline.reports import PAGE_FILE, report_folder, write_report_folder

    result = workspace.existing(arguments["result"])
    progress("read", 0, None, f"reading {arguments['result']}")
    folder = report_folder(result)
    write_report_folder(pf.read(result), result, folder, progress=progress)
    return {"page": workspace.name_of(folder / PAGE_FILE)}


def export_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """Files of ``result`` in the ``formats`` (names of outputs) of other programs, to ``out``."""
    from posefuse.pipeline.writing import nearby_session

    result, out = workspace.existing(arguments["result"]), workspace.path(arguments["out"])
    progress("read", 0, None, f"reading {arguments['result']}")
    recording = pf.read(result)
    session = None if recording.is_live else nearby_session(recording, result, workspace.root)
    made = recording.export(out, arguments["formats"], session=None if session is None else session.folder, progress=progress)
    return {"files": [workspace.name_of(path) for path in made]}


def solve_again_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """``result`` solved again with ``edits`` (plain values of `Edits`), to ``out``."""
    from posefuse.foundation.settings import settings_from_mapping

    source, out = workspace.existing(arguments["result"]), workspace.path(arguments["out"])
    edits = settings_from_mapping(arguments["edits"], pf.Edits, where="edits")
    progress("read", 0, None, f"reading {arguments['result']}")
    recording = pf.read(source)
    progress("solve", 0, None, f"solving {len(recording.poses)} time steps again")
    solved = recording.solve(edits=edits)
    progress("write", 0, None, "writing the result")
    solved.save(out)
    progress("write", 1, 1)
    return {"result": arguments["out"]}


def compare_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """Two recordings of one movement, ``a`` (the reference) and ``b``, compared on a page in ``out``."""
    from posefuse.evaluation.compare_page import PAGE_FILE, comparison_figures, write_comparison
    from posefuse.pipeline.reports import to_compare

    a, b = (workspace.existing(arguments[name]) for name in ("a", "b"))
    out = workspace.path(arguments["out"])
    progress("read", 0, None, "reading both")
    pair = to_compare(a, b, None)
    progress("compare", 0, None, "aligning in time and space")
    found = pair.compared()
    write_comparison(out, pair.a, pair.b, found, inputs=(a, b))
    mean_mm = comparison_figures(found)["mean_mm"]
    progress("compare", 1, 1, f"mean distance {mean_mm:.1f} mm")
    return {"page": workspace.name_of(out / PAGE_FILE), "mean_mm": mean_mm}


def batch_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """Every session of ``study``, to ``out``."""
    from posefuse.pipeline.batch.study import PAGE_FILE

    out = workspace.path(arguments["out"])
    study = pf.batch(workspace.existing(arguments["study"]), out, progress=progress)
    for name, reason in study.failed.items():
        progress("batch", len(study.trials), len(study.trials), f"warning: {name}: {reason}")
    return {"page": workspace.name_of(out / PAGE_FILE), "trials": len(study.trials), "failed": dict(study.failed)}


def simulate_walk_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """A test walk in a planned room (file ``scene``), rendered to ``session``, tracked to ``out``, compared with its truth."""
    from posefuse.evaluation.metrics import joint_errors
    from posefuse.formats.truth import read_truth
    from posefuse.simulation.session import SessionPaths

    session, out = workspace.path(arguments["session"]), workspace.path(arguments["out"])
    pf.simulate(workspace.existing(arguments["scene"]), session, progress=progress)
    recording = pf.track(session, out=out, progress=progress)
    errors = joint_errors(recording.poses, read_truth(SessionPaths(session).truth))
    progress("done", 1, 1, f"mean error {errors.mpjpe_mm:.1f} mm against the exact truth")
    return {"result": arguments["out"], "mpjpe_mm": errors.mpjpe_mm}
