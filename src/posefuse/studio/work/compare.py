"""Two recordings of one movement, compared on a page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import posefuse as pf
from posefuse.evaluation.compare_page import PAGE_FILE, comparison_figures, write_comparison
from posefuse.pipeline.comparing import to_compare
from posefuse.studio.workspace import StudioWorkspace


def run(arguments: Mapping[str, Any], workspace: StudioWorkspace, progress: pf.Progress) -> Mapping[str, Any]:
    """`arguments`: ``a`` (the reference), ``b``, ``out`` (names in the workspace)."""
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
