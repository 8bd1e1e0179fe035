"""Accuracy on one page of text, from the figures the experiments left behind."""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from paper.scenes.scenes import CHECK_SEEDS
from posefuse.formats.page import Block, Heading, Note, Table
from posefuse.foundation import atomic_file
from tools.page_marks import markdown

from .runs import BEST_NETWORKS, BEST_S

EXPERIMENTS = ("static", "walking", "drift", "occlusion", "latency", "scaling")
FILE = "accuracy.md"


def report_of(name: str, figures: Mapping[str, Any]) -> list[Block]:
    """Heading, tables and notes of an experiment: its own page and the summary have the same."""
    report: list[Block] = importlib.import_module(f"paper.experiments.{name}").report(figures)
    return report


def write_summary(out: Path) -> Path:
    """Write ``accuracy.md`` from the JSON files in `out`; experiments that were not run, or only quickly, are left out."""
    parts = [
        "# Accuracy",
        "Made by `python -m paper all`. Rendered people with exact truth, the real network in the loop; millimetres; mean "
        "over the paper's 14 joints unless stated otherwise.",
        "No constant is fitted to the people and movements reported here. The noise model and the joint centres were fitted on "
        f"bodies of random seeds 7000 to 7207 (`bench/fit_*.py`); the tables below show the default body, and seeds "
        f"{', '.join(map(str, CHECK_SEEDS))} as a check. "
        "Tested alternatives: [ablation.md](ablation.md).",
        "*none*, *score*, *all*: the paper's weights on the landmarks as they are, time step by time step; *robust*: our "
        "fusion of the same; *+ centres*: landmarks moved to joint centres. "
        "*default*: `posefuse track` without options. *best networks*: the largest networks "
        f"(`--networks {BEST_NETWORKS}`), six times the computation; of the walk, the first {BEST_S:g} s.",
    ]
    for name in EXPERIMENTS:
        file = out / f"{name}.json"
        content = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        if content.get("length") == "full":
            parts += map(_markdown, report_of(name, content["figures"]))
            parts.append(f"`{content['command']}`, {content['date']}, {content['machine']}.")
    path = out / FILE
    with atomic_file(path) as beside:
        beside.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return path


def _markdown(block: Block) -> str:
    if isinstance(block, Table):
        return markdown(block.columns, [[_cell(value) for value in row] for row in block.rows])
    assert isinstance(block, Heading | Note)
    return f"## {block.text}" if isinstance(block, Heading) else block.text


def _cell(value: Any) -> str:
    return f"{value:.1f}" if isinstance(value, float) else "–" if value is None else str(value)
