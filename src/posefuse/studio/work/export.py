"""Files of a recording in the formats of other programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import posefuse as pf
from posefuse.pipeline.session_images import nearby_session
from posefuse.studio.workspace import StudioWorkspace


def run(arguments: Mapping[str, Any], workspace: StudioWorkspace, progress: pf.Progress) -> Mapping[str, Any]:
    """`arguments`: ``result``, ``out`` (names in the workspace), ``formats`` (names of outputs)."""
    result, out = workspace.existing(arguments["result"]), workspace.path(arguments["out"])
    progress("read", 0, None, f"reading {arguments['result']}")
    recording = pf.read(result)
    session = None if recording.is_live else nearby_session(recording, result, workspace.root)
    made = recording.export(out, arguments["formats"], session=None if session is None else session.folder, progress=progress)
    return {"files": [workspace.name_of(path) for path in made]}
