"""The whole-body fit on rendered people who are used in no fit and no choice: `track --body off` and `--body on` side by side.

    PYTHONPATH=. python bench/body_held_out.py --keep DIR [--only walk,T-pose] [--bodies 12] [--seeds 1,2,3] [--for-s 500]

One body per seed. The first run draws the seeds by chance and keeps them in DIR, so no one knows them before. DIR also keeps
rendered scenes, what the networks saw in them, and a line of figures per row and body, so that work can be stopped and
continued at any time: run the same command again. With another version of the code, delete DIR/figures.jsonl; nothing is
rendered or detected again. `--list` names the rows. Tables on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import argparse
import json
import secrets
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from body_figures import ENDS, FLEXIONS, SIDES, figures
from body_rows import ACTIONS, ROWS, Row, scene_of
from rich.console import Console
from rich.table import Table

from posefuse.core import Recording
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.formats.recording import read_recording, write_recording
from posefuse.formats.truth import read_truth
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import changed_config, read_config
from posefuse.pipeline.run import track_session
from posefuse.pipeline.session import find_session
from posefuse.pipeline.solve import config_of, solve_again
from posefuse.simulation.session import simulate

BODIES = 12
WAYS = ("off", "on")
# fits and the reported experiments draw bodies of smaller seeds
_SMALLEST_SEED, _SEEDS = 100_000, 900_000


def seeds_of(keep: Path, count: int, given: str) -> list[int]:
    """Seeds as given, or those kept in the folder; drawn now if there are none."""
    if given:
        return [int(seed) for seed in given.split(",")]
    file = keep / "seeds.json"
    seeds: list[int] = json.loads(file.read_text()) if file.exists() else []
    while len(seeds) < count:
        seeds.append(_SMALLEST_SEED + secrets.randbelow(_SEEDS))
    file.write_text(json.dumps(seeds))
    return seeds[:count]


def tracked(keep: Path, row: Row, seed: int, changes: dict[str, float]) -> Recording:
    """The recording without the fit: from the folder, else rendered and tracked."""
    session, folder = keep / f"{seed}-{row.scene}", keep / f"{seed}-{row.scene}-tracked{row.network and '-' + row.network}"
    if (folder / "done").exists():
        return read_recording(folder)
    if not (session / "truth" / "truth.npz").exists():
        simulate(replace(scene_of(row.scene, seed), **changes), session, processes=1)
    network = {"detector.options.landmarks": row.network} if row.network else {}
    config = replace(read_config(None, network), outputs={}, body="off")

    def silent(*_: object) -> None: ...

    recording = track_session(find_session(session, config), config, StageClock(), silent, silent, silent).recording
    folder.mkdir(exist_ok=True)
    write_recording(folder, recording)
    (folder / "done").touch()
    return recording


def measured(
    keep: Path, rows: list[str], seeds: list[int], for_s: float, changes: dict[str, float] | None = None
) -> list[dict[str, Any]]:
    """A line per row and body; makes what is missing, for so long. changes: of the scenes."""
    kept, began_s = keep / "figures.jsonl", time.monotonic()
    lines = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    done = {(line["seed"], line["row"]) for line in lines}
    for name in rows:
        for seed in seeds:
            if (seed, name) in done or time.monotonic() - began_s > for_s:
                continue
            off = tracked(keep, ROWS[name], seed, changes or {})
            truth = read_truth(keep / f"{seed}-{ROWS[name].scene}" / "truth" / "truth.npz")
            config = config_of(off)
            ways = {way: solve_again(off, changed_config(config, {"body": way})) for way in WAYS}
            line = {"seed": seed, "row": name, **{way: figures(one.poses, truth) for way, one in ways.items()}}
            lines.append(line)
            with kept.open("a") as file:
                file.write(json.dumps(line) + "\n")
            print(f"{name} {seed}: measured", file=sys.stderr, flush=True)
    return [line for line in lines if line["row"] in rows and line["seed"] in seeds]


def mean_of(lines: list[dict[str, Any]], way: str, key: str, *inner: str) -> float:
    values = [[line[way][key][name] for name in inner] if inner else line[way][key] for line in lines]
    return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")


def summary(lines: list[dict[str, Any]]) -> dict[str, Any]:
    """By row, without and with the fit: means over bodies."""
    out: dict[str, Any] = {}
    for name, row in ROWS.items():
        some = [line for line in lines if line["row"] == name]
        if not some:
            continue
        found: dict[str, Any] = {"bodies": len(some), "must_mm": row.must_mm, "aim_mm": row.aim_mm}
        for way in WAYS:
            found[way] = {
                "mean_mm": mean_of(some, way, "joints_mm", *row.joints),
                "worst_joint_mm": max(mean_of(some, way, "joints_mm", joint) for joint in row.joints),
                "nees": mean_of(some, way, "nees"),
                "within_90": {end: mean_of(some, way, "within_90", *(f"{s}_{end}" for s in SIDES)) for end in ENDS},
                "length_off": {segment: mean_of(some, way, "length_off", segment) for segment in SEGMENT_ENDS},
                "flexion_deg": {joint: mean_of(some, way, "flexion_deg", joint) for joint in FLEXIONS},
                "flexion_within_90": {joint: mean_of(some, way, "flexion_within_90", joint) for joint in FLEXIONS},
                "skate_mm": mean_of(some, way, "skate_mm"),
            }
        means = [{way: mean_of([line], way, "joints_mm", *row.joints) for way in WAYS} for line in some]
        found["bodies_better"] = sum(one["on"] < one["off"] for one in means)
        out[name] = found
    return out


def show(found: dict[str, Any]) -> None:
    console = Console(stderr=True, width=190)
    positions = Table(title="Held-out bodies: --body off -> on", title_justify="left")
    columns = ("mean mm", "must", "aim", "worst joint mm", "NEES", "90 % intervals hold, %", "skate mm")
    for column in ("row", "bodies (better)", *columns):
        positions.add_column(column)
    for name, row in found.items():
        off, fit = row["off"], row["on"]
        holds = " ".join(f"{end} {100 * fit['within_90'][end]:.0f}" for end in ENDS)
        pairs = [f"{off[key]:.1f} -> {fit[key]:.1f}" for key in ("mean_mm", "worst_joint_mm", "nees", "skate_mm")]
        wanted = ["" if np.isnan(row[key]) else f"{row[key]:g}" for key in ("must_mm", "aim_mm")]
        positions.add_row(name, f"{row['bodies']} ({row['bodies_better']})", pairs[0], *wanted, *pairs[1:3], holds, pairs[3])
    console.print(positions)
    actions = [name for name in ACTIONS if name in found]
    if actions:
        worst = {way: max(actions, key=lambda name: found[name][way]["mean_mm"]) for way in WAYS}
        least = " -> ".join(f"{worst[way]} {found[worst[way]][way]['mean_mm']:.1f}" for way in WAYS)
        console.print(f"worst of {', '.join(actions)}: {least} mm (must 13, aim 10)")
    title = "Flexion RMSE, degrees (90 % intervals that hold with the fit, %), and segment lengths off by, %"
    angles = Table(title=title, title_justify="left")
    for column in ("row", *FLEXIONS, *SEGMENT_ENDS):
        angles.add_column(column)
    for name, row in found.items():
        off, fit = row["off"], row["on"]
        holds = {joint: f"({100 * share:.0f})" for joint, share in fit["flexion_within_90"].items()}
        bends = [f"{off['flexion_deg'][j]:.1f} -> {fit['flexion_deg'][j]:.1f} {holds[j]}" for j in FLEXIONS]
        lengths = [f"{100 * off['length_off'][s]:.1f} -> {100 * fit['length_off'][s]:.1f}" for s in SEGMENT_ENDS]
        angles.add_row(name, *bends, *lengths)
    console.print(angles)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--keep", type=Path, help="folder that keeps scenes and figures")
    parser.add_argument("--only", default="", help="rows, separated by commas; default: all")
    parser.add_argument("--bodies", type=int, default=BODIES, help="how many")
    parser.add_argument("--seeds", default="", help="these, separated by commas, instead of drawn ones")
    parser.add_argument("--rate-hz", type=float, help="of the cameras, instead of 10")
    parser.add_argument("--seconds", type=float, help="length of every scene, instead of its own")
    parser.add_argument("--for-s", type=float, default=1e9, help="begin no scene after so many seconds")
    parser.add_argument("--list", action="store_true", help="name the rows")
    arguments = parser.parse_args()
    if arguments.list:
        print("\n".join(ROWS))
        return
    rows = arguments.only.split(",") if arguments.only else list(ROWS)
    unknown = [name for name in rows if name not in ROWS]
    if unknown or arguments.keep is None:
        parser.error(f"no row {unknown[0]!r}; there are: {', '.join(ROWS)}" if unknown else "--keep DIR is required")
    arguments.keep.mkdir(parents=True, exist_ok=True)
    seeds = seeds_of(arguments.keep, arguments.bodies, arguments.seeds)
    changes = {"rate_hz": arguments.rate_hz, "duration_s": arguments.seconds}
    changed = {name: value for name, value in changes.items() if value is not None}
    found = summary(measured(arguments.keep, rows, seeds, arguments.for_s, changed))
    show(found)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
