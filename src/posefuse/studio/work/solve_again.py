"""A recording solved again with edits, into a folder of its own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import posefuse as pf
from posefuse.foundation.settings import settings_from_mapping
from posefuse.pipeline.edits import Edits
from posefuse.studio.workspace import StudioWorkspace


def run(arguments: Mapping[str, Any], workspace: StudioWorkspace, progress: pf.Progress) -> Mapping[str, Any]:
    """`arguments`: ``result``, ``out`` (names in the workspace), ``edits`` (plain values of `Edits`)."""
    source, out = workspace.existing(arguments["result"]), workspace.path(arguments["out"])
    edits = settings_from_mapping(arguments["edits"], Edits, where="edits")
    progress("read", 0, None, f"reading {arguments['result']}")
    recording = pf.read(source)
    progress("solve", 0, None, f"solving {len(recording.poses)} time steps again")
    solved = recording.solve(edits=edits)
    progress("write", 0, None, "writing the result")
    solved.save(out)
    progress("write", 1, 1)
    return {"result": arguments["out"]}
