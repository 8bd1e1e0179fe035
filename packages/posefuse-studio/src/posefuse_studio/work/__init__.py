"""What jobs do, in processes of their own (see `job_process`), by the public API.

A function NAME_job makes something of recordings; other work is ``run`` of a module NAME in here. Each takes arguments with names
in the workspace, and gives JSON values.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import posefuse as pf
from posefuse_studio.workspace import StudioWorkspace

Arguments = Mapping[str, Any]
Result = Mapping[str, Any]


def report_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """The report of ``result``: angles, gait, files for other programs, one page."""
    progress("read", 0, None, f"reading {arguments['result']}")
    made = pf.read(workspace.existing(arguments["result"])).report(progress=progress)
    return {"page": workspace.name_of(next(path for path in made if path.suffix == ".html"))}


def export_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """Files of ``result`` in the ``formats`` (names of outputs) of other programs, to ``out``."""
    out = workspace.path(arguments["out"])
    progress("read", 0, None, f"reading {arguments['result']}")
    recording = pf.read(workspace.existing(arguments["result"]))
    made = recording.export(out, arguments["formats"], within=workspace.root, progress=progress)
    return {"files": [workspace.name_of(path) for path in made.files], "failed": dict(made.failed)}


def solve_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """``result`` solved again with ``edits`` (plain values of `Edits`), to ``out``."""
    from posefuse.foundation.settings import settings_from_mapping

    edits = settings_from_mapping(arguments["edits"], pf.Edits, where="edits")
    source, out = workspace.existing(arguments["result"]), workspace.path(arguments["out"])
    progress("solve", 0, None, f"solving {arguments['result']} again")
    pf.solve(source, out, edits=edits, settings={"outputs": ()}, progress=progress)
    return {"recordings": [arguments["out"]]}


def compare_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """Two recordings of one movement, ``a`` (the reference) and ``b``, compared on a page in ``out``."""

    a, b = (workspace.existing(arguments[name]) for name in ("a", "b"))
    progress("compare", 0, None, "reading both, aligning in time and space")
    found = pf.compare(a, b)
    page = found.save(workspace.path(arguments["out"]))
    progress("compare", 1, 1, f"mean distance {found.errors.mpjpe_mm:.1f} mm")
    return {"page": workspace.name_of(page), "mean_mm": found.errors.mpjpe_mm}


def batch_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """Every session of ``study``, to ``out``, by the ``networks`` of a name; empty: the usual ones."""
    place, out = workspace.existing(arguments["study"]), workspace.path(arguments["out"])
    study = pf.batch(place, out, networks=arguments.get("networks") or None, progress=progress)
    for name, reason in study.failed.items():
        progress("batch", len(study.trials), len(study.trials), f"warning: {name}: {reason}")
    return {"page": workspace.name_of(study.page), "failed": dict(study.failed)}


def simulate_walk_job(arguments: Arguments, workspace: StudioWorkspace, progress: pf.Progress) -> Result:
    """A test walk in a planned room (file ``scene``), rendered to ``session``, tracked to ``out``, compared with its truth."""
    session, out = workspace.path(arguments["session"]), workspace.path(arguments["out"])
    pf.simulate(workspace.existing(arguments["scene"]), session, progress=progress)
    mpjpe_mm = pf.track(session, out=out, formats=(), progress=progress).figures["mpjpe_mm"]
    progress("done", 1, 1, f"mean error {mpjpe_mm:.1f} mm against the exact truth")
    return {"recordings": [arguments["out"]], "mpjpe_mm": mpjpe_mm}
