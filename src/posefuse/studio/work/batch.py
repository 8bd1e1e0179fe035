"""Every session of a study."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import posefuse as pf
from posefuse.pipeline.batch.study import PAGE_FILE
from posefuse.studio.workspace import StudioWorkspace


def run(arguments: Mapping[str, Any], workspace: StudioWorkspace, progress: pf.Progress) -> Mapping[str, Any]:
    """`arguments`: ``study``, ``out``: names in the workspace."""
    out = workspace.path(arguments["out"])
    study = pf.batch(workspace.existing(arguments["study"]), out, progress=progress)
    for name, reason in study.failed.items():
        progress("batch", len(study.trials), len(study.trials), f"warning: {name}: {reason}")
    return {"page": workspace.name_of(out / PAGE_FILE), "trials": len(study.trials), "failed": dict(study.failed)}
