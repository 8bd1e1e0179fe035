"""A test walk in a planned room: rendered, tracked, and compared with its exact truth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import posefuse as pf
from posefuse.evaluation.metrics import joint_errors
from posefuse.formats.truth import read_truth
from posefuse.simulation.session import SessionPaths
from posefuse.studio.workspace import StudioWorkspace


def run(arguments: Mapping[str, Any], workspace: StudioWorkspace, progress: pf.Progress) -> Mapping[str, Any]:
    """`arguments`: ``scene`` (file), ``session``, ``out`` (folders to make): names in the workspace."""
    session, out = workspace.path(arguments["session"]), workspace.path(arguments["out"])
    pf.simulate(workspace.existing(arguments["scene"]), session, progress=progress)
    recording = pf.track(session, out=out, progress=progress)
    errors = joint_errors(recording.poses, read_truth(SessionPaths(session).truth))
    progress("done", 1, 1, f"mean error {errors.mpjpe_mm:.1f} mm against the exact truth")
    return {"result": arguments["out"], "mpjpe_mm": errors.mpjpe_mm}
