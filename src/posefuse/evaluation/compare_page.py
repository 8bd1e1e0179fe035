"""The page and the figures of a comparison of two recordings."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.formats.page import Facts, Heading, Line, Note, Page, Plot, Plots, Table, write_page
from posefuse.foundation.output_folder import output_folder
from posefuse.foundation.parsing import plain

from .compare import Comparison, Tracks, middle_of

PAGE_FILE, FIGURES_FILE = "compare.html", "compare.json"


def write_comparison(
    out: Path, a: Tracks, b: Tracks, found: Comparison, *, inputs: Sequence[Path], warn: Callable[[str], None] | None = None
) -> list[Path]:
    """Write the page and the figures into a folder, in place of an unchanged earlier comparison; returns the files.

    Raises:
        InputError: the folder holds anything else, or overlaps an input.
    """
    # its own, unchanged, can be made again at any time: replaced without being asked
    with output_folder(out, command="compare", inputs=inputs, replace=True, warn=warn) as place:
        text = json.dumps(plain(comparison_figures(found)), indent=2) + "\n"
        (place.folder / FIGURES_FILE).write_text(text, encoding="utf-8")
        write_page(place.folder / PAGE_FILE, comparison_page(a, b, found))
    return [out / PAGE_FILE, out / FIGURES_FILE]


def distance_rows(found: Comparison) -> list[list[Any]]:
    """Rows of the table: point, mean, standard deviation, median, 95th percentile in mm, share compared."""
    points = comparison_figures(found)["points"]
    return [[point.replace("_", " "), *list(row.values())[:-1], f"{row['found']:.0%}"] for point, row in points.items()]


def alignment_facts(found: Comparison) -> dict[str, Any]:
    """The alignment and the mean figures in words."""
    turn = np.degrees(np.arccos(np.clip((np.trace(found.alignment.rotation) - 1) / 2, -1, 1)))
    return {
        "offset in time": f"{1000 * found.alignment.offset_s:.1f} ms",
        "turned by": f"{turn:.2f} deg",
        "moved by": f"{np.linalg.norm(found.alignment.shift_m):.3f} m",
        "scale": f"{found.alignment.scale:.4f}",
        "mean distance": f"{found.errors.mpjpe_mm:.1f} mm over {len(found.points)} points",
        "drift": f"{found.drift_mm_per_m:.1f} mm per m over {found.walked_m[-1]:.1f} m walked",
    }


def comparison_figures(found: Comparison) -> dict[str, Any]:
    """The comparison as plain values, point by point."""
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


def comparison_page(a: Tracks, b: Tracks, found: Comparison) -> Page:
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
            *(Note(one.warning, warning=True) for one in (a, b) if one.warning),
            Heading("Alignment", f"{b.name} is aligned to {a.name}."),
            Facts(alignment_facts(found)),
            Heading("Distances"),
            Table(["point", "mean mm", "sd mm", "median mm", "p95 mm", "share compared"], distance_rows(found)),
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
