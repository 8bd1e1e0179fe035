"""What `posefuse compare` does around the comparison: files of several systems to named tracks, a page, figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.command_options import CompareOptions
from posefuse.evaluation.compare_page import PAGE_FILE, alignment_facts, comparison_figures, distance_rows, write_comparison
from posefuse.foundation.output_folder import check_replaceable
from posefuse.foundation.places import check_outside_inputs
from posefuse.pipeline.reports import to_compare

from .terminal import Terminal


def compare_files(path_a: Path, path_b: Path, options: CompareOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Compare two recordings, write the page, show the figures."""
    if options.out:
        check_outside_inputs(options.out, (path_a, path_b))
        check_replaceable(options.out, command="compare", replace=True)
    pair = to_compare(path_a, path_b, options.person, terminal.warn)
    a, b = pair.a, pair.b
    if pair.exact:
        terminal.note(f"{path_a} is the truth of a simulation: nothing is aligned, times and world are its own")
    elif pair.one_world and not (options.no_space or options.scale or options.align_first):
        terminal.note("both have the coordinates of one calibration: they are not aligned in space")
    found = pair.compared(time=not options.no_time, space=not options.no_space, scale=options.scale, start_s=options.align_first)
    figures = comparison_figures(found)
    terminal.facts("Alignment of the second onto the first", alignment_facts(found))
    terminal.table("Distances, mm", ["point", "mean", "sd", "median", "p95", "share compared"], distance_rows(found))
    if options.out:
        write_comparison(options.out, a, b, found, inputs=(path_a, path_b), warn=terminal.warn)
        page = options.out / PAGE_FILE
        terminal.note(f"written: {page}")
        terminal.next(f"open {page} in a browser", "every point over time, and the drift")
    else:
        terminal.next("the same with --out DIR", "a page with every point over time, and compare.json")
    return figures
