"""Accuracy on one page of text, from the figures the experiments left behind."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from paper.scenes import paper
from paper.scenes.scenes import CHECK_SEEDS
from posefuse.foundation import atomic_file
from tools.page_marks import markdown

from .drift import path_rows
from .latency import processor_rows
from .occlusion import TITLES as TITLES_HALF_HIDDEN
from .occlusion import summary_rows
from .runs import BEST_NETWORKS, BEST_S
from .static import TITLES
from .tables import joint_rows
from .walking import STATED

FILE = "accuracy.md"
_SHOWN = ("none", "score", "all", "robust", "default", "best networks")
_CHECKED = ("default", "best networks")


def write_summary(out: Path) -> Path:
    """Write ``accuracy.md`` from the JSON files in `out`; experiments that were not run, or only quickly, are left out."""
    read = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(out.glob("*.json"))}
    full = {name: content for name, content in read.items() if content.get("length") == "full"}
    parts = [
        "# Accuracy",
        "Made by `python -m paper all`. Rendered people with exact truth, the real network in the loop; millimetres; mean "
        "over the paper's 14 joints unless stated otherwise.",
        "No constant is fitted to the people and movements reported here. The noise model and the joint centres were fitted on "
        f"bodies of random seeds 7000 to 7207 (`bench/fit_*.py`); the tables below show the default body, and seeds "
        f"{', '.join(map(str, CHECK_SEEDS))} as a check. "
        "Tested alternatives: [ablation.md](ablation.md).",
        "*default*: `posefuse track` without options. *best networks*: the largest networks "
        f"(`--networks {BEST_NETWORKS}`), six times the computation; of the walk, the first {BEST_S:g} s.",
    ]
    for writer in (_static, _walking, _drift, _occlusion, _latency, _scaling):
        if content := full.get(writer.__name__.strip("_")):
            parts += [*writer(content["figures"]), f"`{content['command']}`, {content['date']}, {content['machine']}."]
    path = out / FILE
    with atomic_file(path) as beside:
        beside.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return path


def _table(columns: list[str], rows: list[list[Any]]) -> str:
    def cell(value: Any) -> str:
        return f"{value:.1f}" if isinstance(value, float) else "–" if value is None else str(value)

    return markdown(columns, [[cell(value) for value in row] for row in rows])


def _static(figures: Mapping[str, Any]) -> list[str]:
    rows = []
    for case in TITLES:
        for name, column in figures[case].items():
            rows.append([f"{case}, {name}", column["mean_mm"], column["worst_mm"], paper.STATIC_AVERAGE[case].get(name)])
        for what in _CHECKED:
            seeds = [one[what] for one in figures["check"][case].values() if what in one]
            if seeds:
                rows.append([f"{case}, {what}, other bodies", ", ".join(f"{mm:.1f}" for mm in seeds), None, None])
    parts = ["## T-pose, eight cameras", _table(["", "mean", "worst joint", "paper"], rows)]
    for case, title in TITLES.items():
        columns = {name: figures[case][name] for name in _SHOWN if name in figures[case]}
        parts += [f"{title}, per joint, mean ± standard deviation:", _table(*joint_rows(columns, paper.STATIC[case]))]
    return parts


def _walking(figures: Mapping[str, Any]) -> list[str]:
    checked = [(what, seed, one[what]) for what in _CHECKED for seed, one in figures["check"].items() if what in one]
    columns = {**figures["columns"], **{f"{what}, body and movement of seed {seed}": one for what, seed, one in checked}}
    rows = [[name, one["mean_mm"], one["worst_mm"], one["worst_joint"].replace("_", " ")] for name, one in columns.items()]
    rows.append(["paper", paper.WALKING_MEAN, paper.WALKING_WORST, None])
    stated = ", ".join(f"{value:.1f} {name}" for name, value in figures["nees"].items())
    return [
        "## Walking, four cameras",
        _table(["", "mean", "worst joint", "which"], rows),
        "Per joint, mean ± standard deviation:",
        _table(*joint_rows({name: figures["columns"][name] for name in _SHOWN if name in figures["columns"]}, {}, STATED)),
        f"Stated uncertainty against these errors (typical NEES; 3 is right, more is overconfident): {stated}.",
    ]


def _drift(figures: Mapping[str, Any]) -> list[str]:
    columns = ["path", "walked m", "drift mm per m", "suit: drift mm per m", "error at the end mm", "suit: error at the end mm"]
    return ["## Drift on three paths, compared with a simulated inertial suit", _table(columns, path_rows(figures))]


def _occlusion(figures: Mapping[str, Any]) -> list[str]:
    nees = "; ".join(
        f"{TITLES_HALF_HIDDEN[case].lower()}: " + ", ".join(f"{value:.1f} {part}" for part, value in one["nees"].items())
        for case, one in figures.items()
    )
    return [
        "## Half of the body hidden, compared with a simulated inertial suit",
        "Four cameras in the corners of a room; a person waves with the left arm. Mean error over joints.",
        _table(["", "joints", *figures["free"]["columns"]], summary_rows(dict(figures))),
        f"Stated uncertainty of the default (typical NEES; 3 is right): {nees}.",
    ]


def _latency(figures: Mapping[str, Any]) -> list[str]:
    tables = []
    for device, live in figures["live"].items():
        stages = list(next(iter(live["cameras"].values()))["stages_ms"])
        rows = [
            [name, *(one["stages_ms"][stage]["mean"] for stage in stages), one["total_ms"]["mean"], one["total_ms"]["p95"],
             one["decode_alone_ms"]]
            for name, one in live["cameras"].items()
        ]  # fmt: skip
        tables += [
            f"Device: {device} ({live['processor']}):",
            _table(["camera", *stages, "end to end", "p95", "decoding alone"], rows),
            f"{100 * live['used_share']:.0f} % of the frames used, {live['output_hz']:.1f} poses per second.",
        ]
    return [
        "## Latency, four cameras",
        "Live, from mid-exposure to another program: mean ms per camera. capture: until the decoded image is in its process; "
        "wait: for the detector; output: until the next output tick of 100 Hz; send: by UDP.",
        *tables,
        "By processor, next to the paper's 2D per frame and triangulation on GPUs, mean ms of all cameras:",
        _table(*processor_rows(figures["live"])),
        "Recorded, at full speed: [benchmarks.md](benchmarks.md#the-whole-pipeline-on-the-demo-clip).",
    ]


def _scaling(figures: Mapping[str, Any]) -> list[str]:
    def listed(study: Mapping[str, Any], key: str) -> str:
        return ", ".join(f"{x:g}: {mm:.1f}" for x, mm in zip(study["x"], study[key], strict=True))

    keys = ("robust_mm", "robust_same_mm", "score_same_mm")
    rows = [[study["title"], *(listed(study, key) for key in keys)] for study in figures["studies"].values()]
    return [
        "## What the error depends on",
        "Oracle detections, not smoothed; value: mm. Weights are compared on the points that both methods return: with few "
        "views `score` returns none for the difficult ones.",
        _table(["", "robust", "robust, common points", "score, common points"], rows),
    ]
