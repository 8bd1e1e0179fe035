"""Time per stage of the pipeline and from image to skeleton (the paper's latency experiment)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from posefuse.app.recorded.clock import StageClock
from posefuse.core.arrays import Array
from posefuse.evaluate.experiments import paper
from posefuse.evaluate.experiments.page import Line, Page, plot
from posefuse.evaluate.experiments.scenes import walking_scene

from .runs import Context, Outcome, run_scene

SUMMARY = "time per stage, 4 cameras: decode, 2D, fuse"
_QUICK_S, _FULL_S = 2.0, 60.0
_STAGES = ("decode", "detect", "fuse")
_SPIKES_S = 1.0


class SpikeClock(StageClock):
    """Also keeps when each block began and how long it took."""

    def __init__(self) -> None:
        super().__init__()
        self.spans: list[tuple[str, float, float]] = []

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time the block, and keep its begin and length in seconds."""
        began_s = time.perf_counter()
        with super().stage(name):
            yield
        self.spans.append((name, began_s, time.perf_counter() - began_s))


def run(context: Context) -> Outcome:
    """Run the walking session and time every instant."""
    clock = SpikeClock()
    done = run_scene("walking-1", walking_scene(1, _QUICK_S if context.quick else _FULL_S), context, clock)
    spans = {stage: np.array([(begin, took) for name, begin, took in clock.spans if name == stage]) for stage in _STAGES}
    per_instant = {stage: 1000 * _per_instant(spans[stage], spans["decode"][:, 0]) for stage in _STAGES}
    total = np.sum(list(per_instant.values()), axis=0)
    cameras = len(done.recording.rig)
    stages = {
        "decode (wait for the next images)": per_instant["decode"],
        "2D pose, all cameras": per_instant["detect"],
        "2D pose, per image": per_instant["detect"] / cameras,
        "associate and fuse": per_instant["fuse"],
        "images to skeleton": total,
    }
    figures: dict[str, Any] = {
        "cameras": cameras,
        "instants": len(total),
        "stages_ms": {name: _spread(ms) for name, ms in stages.items()},
        "instants_per_s": float(1000 / total.mean()),
        "paper_ms": {"capture": paper.CAPTURE_MS, "2D pose": list(paper.DETECT_MS), "triangulation": paper.TRIANGULATE_MS},
    }
    page = Page("Latency")
    page.section(
        "Time per stage",
        "Four cameras, one process, recorded images: decoding runs ahead in threads, so its time is what is left to wait for. A "
        f"camera at 30 Hz adds up to {paper.CAPTURE_MS} ms of capture. Live, with a camera's own clock: posefuse live --help.",
    )
    rows = [[name, *spread.values()] for name, spread in figures["stages_ms"].items()]
    page.table(["stage", "median ms", "mean ms", "p95 ms", "most ms"], rows)
    page.facts(
        {
            "instants per second": figures["instants_per_s"],
            "paper: 2D pose per image": f"{paper.DETECT_MS[0]:g} to {paper.DETECT_MS[1]:g} ms on three GPUs",
            "paper: triangulation": f"< {paper.TRIANGULATE_MS:g} ms",
        }
    )
    instants = np.arange(len(total), dtype=float)
    page.plots(
        [
            plot("Spikes", "s of the run", "ms", _spikes(spans)),
            plot("Every instant", "instant", "ms", [Line(k, instants, v) for k, v in per_instant.items()], from_zero=True),
        ]
    )
    return Outcome(figures, page)


def _spread(ms: Array) -> dict[str, float]:
    return {
        "median": float(np.median(ms)),
        "mean": float(ms.mean()),
        "p95": float(np.percentile(ms, 95)),
        "most": float(ms.max()),
    }


def _per_instant(spans: Array, begins_s: Array) -> Array:
    """Seconds (T,) that blocks took between one instant's begin and the next's; the last decode found nothing more."""
    place = np.searchsorted(begins_s, spans[:, 0], side="right") - 1
    return np.bincount(place, weights=spans[:, 1], minlength=len(begins_s))[:-1]


def _spikes(spans: dict[str, Array]) -> list[Line]:
    """One triangle per block, in the middle of the run."""
    middle = float(np.median(spans["detect"][:, 0]))
    lines = []
    for stage, rows in spans.items():
        near = rows[np.abs(rows[:, 0] - middle) < _SPIKES_S / 2]
        x = np.stack([near[:, 0], near[:, 0], near.sum(axis=1)], axis=1) - middle
        y = np.stack([np.zeros(len(near)), 1000 * near[:, 1], np.zeros(len(near))], axis=1)
        lines.append(Line(stage, x.ravel(), y.ravel()))
    return lines
