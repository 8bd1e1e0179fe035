"""The report of a recording: angles, gait, files for other programs, one page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import posefuse as pf
from posefuse.pipeline.reporting import PAGE_FILE, report_folder, write_report_folder
from posefuse.studio.workspace import StudioWorkspace


def run(arguments: Mapping[str, Any], workspace: StudioWorkspace, progress: pf.Progress) -> Mapping[str, Any]:
    """`arguments`: ``result``, a name in the workspace."""
    result = workspace.existing(arguments["result"])
    progress("read", 0, None, f"reading {arguments['result']}")
    folder = report_folder(result)
    write_report_folder(pf.read(result), result, folder, progress=progress)
    return {"page": workspace.name_of(folder / PAGE_FILE)}
