"""What `posefuse compare` does around the comparison: files of several systems to named tracks, a page, figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.cli.options.compare import CompareOptions
from posefuse.evaluation.compare import Comparison, Tracks, compare, middle_of
from posefuse.formats.page import Facts, Heading, Line, Page, Plot, Plots, Table, write_page
from posefuse.foundation.output_folder import check_replaceable, output_folder
from posefuse.foundation.places import check_apart
from posefuse.foundation.plain_values import plain
from posefuse.pipeline.comparing import to_compare

from .terminal import Terminal


def compare_files(path_a: Path, path_b: Path, options: CompareOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Compare two recordings, write the page, show the figures."""
    if options.out:
        check_apart(options.out, (path_a, path_b))
        check_replaceable(options.out, command="compare", replace=True)
    pair = to_compare(path_a, path_b, options.person, terminal.warn)
    a, b = pair.a, pair.b
    if pair.exact:
        terminal.note(f"{path_a} is the truth of a simulation: nothing is aligned, times and world are its own")
    aligned_in_time, aligned_in_space = not (options.no_time or pair.exact), not (options.no_space or pair.exact)
    found = compare(a, b, time=aligned_in_time, space=aligned_in_space, scale=options.scale, start_s=options.align_first)
    figures = _figures(found)
    rows = [[point.replace("_", " "), *row.values()] for point, row in figures["points"].items()]
    terminal.facts("Alignment of the second onto the first", _facts(found))
    terminal.table("Distances, mm", ["point", "mean", "sd", "median", "p95", "share compared"], rows)
    if options.out:
        # its own, unchanged, can be made again at any time: replaced without being asked
        with output_folder(options.out, command="compare", inputs=(path_a, path_b), replace=True, warn=terminal.warn) as out:
            write_page(out.folder / "compare.html", comparison_page(a, b, found, rows))
            (out.folder / "compare.json").write_text(json.dumps(plain(figures), indent=2) + "\n", encoding="utf-8")
        page = options.out / "compare.html"
        terminal.note(f"written: {page}")
        terminal.next(f"open {page} in a browser", "every point over time, and the drift")
    else:
        terminal.next("the same with --out DIR", "a page with every point over time, and compare.json")
    return figures


def _facts(found: Comparison) -> dict[str, Any]:
    turn = np.degrees(np.arccos(np.clip((np.trace(found.alignment.rotation) - 1) / 2, -1, 1)))
    return {
        "offset in time": f"{1000 * found.alignment.offset_s:.1f} ms",
        "turned by": f"{turn:.2f} deg",
        "moved by": f"{np.linalg.norm(found.alignment.shift_m):.3f} m",
        "scale": f"{found.alignment.scale:.4f}",
        "mean distance": f"{found.errors.mpjpe_mm:.1f} mm over {len(found.points)} points",
        "drift": f"{found.drift_mm_per_m:.1f} mm per m over {found.walked_m[-1]:.1f} m walked",
    }


def _figures(found: Comparison) -> dict[str, Any]:
    errors = found.errors
    return {
        "offset_s": found.alignment.offset_s,
        "rotation": found.alignment.rotation.tolist(),
        "shift_m": found.alignment.shift_m.tolist(),
        "scale": found.alignment.scale,
        "residual_mm": 1000 * found.alignment.residual_m,
        "mean_mm": errors.mpjpe_mm,
        "drift_mm_per_m": found.drift_mm_per_m,
        "walked_m": float(found.walked_m[-1]),
        "points": {
            point: {
                "mean_mm": float(errors.mean_mm[k]),
                "sd_mm": float(errors.sd_mm[k]),
                "median_mm": float(errors.median_mm[k]),
                "p95_mm": float(errors.p95_mm[k]),
                "found": float(errors.found[k]),
            }
            for k, point in enumerate(found.points)
        },
    }


def comparison_page(a: Tracks, b: Tracks, found: Comparison, rows: list[list[Any]]) -> Page:
    """Alignment, distances, drift and every point over time."""
    t_s = found.t_s - found.t_s[0]
    both = np.isfinite(found.a_m) & np.isfinite(found.b_m)
    middle = [middle_of(np.where(both, one, np.nan)) for one in (found.a_m, found.b_m)]
    apart = Line("apart", found.walked_m, 1000 * found.apart_m)
    paths = [Line(name, m[:, 0], m[:, 1]) for name, m in zip((a.name, b.name), middle, strict=True)]
    points = [
        Plot(
            f"{point.replace('_', ' ')}, {axis}",
            [Line(a.name, t_s, found.a_m[:, k, i]), Line(b.name, t_s, found.b_m[:, k, i])],
            x_label="s", y_label="m",
        )
        for k, point in enumerate(found.points)
        for i, axis in enumerate("xyz")
    ]  # fmt: skip
    return Page(
        f"{b.name} compared with {a.name}",
        [
            Heading("Alignment", f"{b.name} is aligned to {a.name}."),
            Facts(_facts(found)),
            Heading("Distances"),
            Table(["point", "mean mm", "sd mm", "median mm", "p95 mm", "share compared"], rows),
            Heading("Drift", "Horizontal distance between the means of all points."),
            Plots(
                [
                    Plot("Along the path", [apart], x_label="distance walked, m", y_label="mm", from_zero=True),
                    Plot("From above", paths, x_label="x, m", y_label="y, m", equal=True),
                ]
            ),
            Heading("Points over time"),
            Plots(points, small=True),
        ],
    )
