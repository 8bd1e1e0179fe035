"""The whole-body fit on rendered people who are used in no fit and no choice: `track --body off` and `--body on` side by side.

    python bench/body_held_out.py --keep DIR [--only walk T-pose] [--bodies 12] [--seeds 1,2,3]

One body per seed. The first run draws the seeds by chance and keeps them in DIR, so no one knows them before. DIR also keeps
the rendered scenes, and out/bench what was tracked per version of the code, so that work can be stopped and continued at any
time: run the same command again. Tables on stderr, one JSON object on stdout.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from bodies import ACTIONS, ROWS, Row, scene_of, seeds_of
from body_figures import ENDS, FLEXIONS, figures
from harness import OUT, Use, answer, arguments, note, rendered, tracked, truth_of

from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.core.skeleton import SIDES
from posefuse.pipeline.config import changed_config
from posefuse.pipeline.solve import config_of, solve_again

BODIES = 12
WAYS = ("off", "on")
Line = dict[str, Any]


def measured(session: Path, row: Row) -> Line:
    """Figures without and with the fit."""
    options = {"detector__options__landmarks": row.network} if row.network else {}
    off, truth = tracked(session, body="off", **options), truth_of(session)
    return {way: figures(solve_again(off, changed_config(config_of(off.provenance), {"body": way})).poses, truth) for way in WAYS}


def lines_of(keep: Path, rows: list[str], seeds: list[int], changes: dict[str, float]) -> list[Line]:
    """A line per row and body. changes: of the scenes."""
    lines = []
    for name, seed in product(rows, seeds):
        scene = replace(scene_of(ROWS[name].scene, seed), **changes)
        session = rendered(scene, keep / f"{seed}-{ROWS[name].scene}", Use.REPORT)
        lines.append({"seed": seed, "row": name, **measured(session, ROWS[name])})
        note(f"{name} {seed}: measured")
    return lines


def mean_of(lines: list[Line], way: str, key: str, *inner: str) -> float:
    values = [[line[way][key][name] for name in inner] if inner else line[way][key] for line in lines]
    return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")


def positions(name: str, lines: list[Line], way: str) -> Line:
    """Means over the bodies of a row."""
    joints, within = ROWS[name].joints, {end: [f"{side}_{end}" for side in SIDES] for end in ENDS}
    better = sum(mean_of([line], "on", "joints_mm", *joints) < mean_of([line], "off", "joints_mm", *joints) for line in lines)
    return {
        "row": name, "body": way, "bodies": len(lines), "better": better,
        "mean_mm": mean_of(lines, way, "joints_mm", *joints),
        "worst_joint_mm": max(mean_of(lines, way, "joints_mm", joint) for joint in joints),
        "nees": mean_of(lines, way, "nees"), "skate_mm": mean_of(lines, way, "skate_mm"),
        "within_90": {end: mean_of(lines, way, "within_90", *names) for end, names in within.items()},
    }  # fmt: skip


def angles(name: str, lines: list[Line], way: str) -> Line:
    return {
        "row": name, "body": way,
        **{f"{joint}_deg": mean_of(lines, way, "flexion_deg", joint) for joint in FLEXIONS},
        "within_90": {joint: mean_of(lines, way, "flexion_within_90", joint) for joint in FLEXIONS},
        **{segment: mean_of(lines, way, "length_off", segment) for segment in SEGMENT_ENDS},
    }  # fmt: skip


def main() -> None:
    args = arguments(__doc__, keep=OUT / "held_out", only=ROWS, bodies=BODIES, seeds="", rate_hz=float, seconds=float)
    changes = {"rate_hz": args.rate_hz, "duration_s": args.seconds}
    changes = {name: value for name, value in changes.items() if value is not None}
    lines = lines_of(args.keep, args.only, seeds_of(args.keep, args.bodies, args.seeds), changes)
    parts = [(name, some, way) for name in args.only if (some := [line for line in lines if line["row"] == name]) for way in WAYS]
    rows = [positions(*part) for part in parts]
    worst = {
        way: max((row["mean_mm"] for row in rows if row["row"] in ACTIONS and row["body"] == way), default=None) for way in WAYS
    }
    title = "Flexion RMSE, degrees, and the share by which segment lengths are off"
    answer(args, {"Held-out bodies": rows, title: [angles(*part) for part in parts]}, worst_action_mm=worst)


if __name__ == "__main__":
    main()
