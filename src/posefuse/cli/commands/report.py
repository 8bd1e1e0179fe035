"""`posefuse report`: joint angles, gait, files for biomechanics tools and one page about a result."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal
from posefuse.core import Progress

SUMMARY = "joint angles of a result: one HTML page, and files for OpenSim, Visual3D, Mokka, Blender and spreadsheets"
FOLDER = "biomechanics"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The result, how angles are made, where they go."""
    parser.add_argument("result", type=Path, metavar="DIR", help="result folder of `posefuse track`, or .mcap of `posefuse live`")
    parser.add_argument("--out", type=Path, metavar="FOLDER", help=f"folder for the files (default DIR/{FOLDER}, NAME_{FOLDER})")
    parser.add_argument(
        "--fit", choices=("none", "points", "rays"), default="points",
        help="fit one skeleton of constant lengths to the 3D points (default), to the rays of all views, or not at all",
    )  # fmt: skip
    parser.add_argument("--title", metavar="TEXT", help="title of the page (default: Motion report)")
    parser.add_argument("--opensim", action="store_true", help="run OpenSim's inverse kinematics too (extra: biomech)")


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Write the files; returns their names."""
    from posefuse.evaluation.biomechanics import BiomechanicsSettings, write_biomechanics
    from posefuse.evaluation.report import TITLE
    from posefuse.foundation.compiled import compiling
    from posefuse.foundation.output_folder import output_folder
    from posefuse.pipeline.reading import files_of_result, is_live, read_result

    recording = read_result(args.result, terminal.warn)
    beside = args.result.with_name(f"{args.result.stem}_{FOLDER}") if is_live(args.result) else args.result / FOLDER
    out = args.out or beside
    chosen = BiomechanicsSettings(fit=args.fit, opensim=args.opensim)
    inputs = files_of_result(args.result)
    # what it wrote itself, and nobody changed, can be made again at any time: replaced without being asked
    with (
        output_folder(out, command="report", inputs=inputs, replace=True, warn=terminal.warn) as place,
        compiling("joint angles", terminal.note),
    ):
        made = write_biomechanics(recording, place.folder, chosen, title=args.title or TITLE, progress=_shown(terminal))
        names = [path.relative_to(place.folder).as_posix() for path in made]
    terminal.facts(
        "Biomechanics", {"people": len(recording.poses.person_id), "files": ", ".join(names), "look at": str(out / "report.html")}
    )
    terminal.next(f"open {out / 'report.html'} in a browser", "angles.csv and angles.mot beside it hold the numbers")
    return {"out": out, "files": names, "people": len(recording.poses.person_id)}


def _shown(terminal: Terminal) -> Progress:
    def show(stage: str, done: int, total: int | None, message: str = "") -> None:
        if message:
            terminal.note(f"{stage} {done + 1} of {total}: {message}")

    return show
