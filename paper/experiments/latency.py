"""Time per stage and end to end, live and recorded (the paper's latency experiment)."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from paper.scenes import paper
from paper.scenes.scenes import walking_scene
from posefuse.core import Array
from posefuse.formats import read_video
from posefuse.formats.page import Block, Facts, Heading, Line, Page, Plot, Plots, Table
from posefuse.pipeline import StageClock
from posefuse.simulation import SessionPaths

from .live_page import live_blocks, live_figures, spread
from .live_times import live_times
from .runs import Context, Outcome, rendered, run_scene

_QUICK_S, _FULL_S = 2.0, 60.0
# on a busy machine seconds pass before the first pose goes out
_QUICK_LIVE_S, _LIVE_S = 8.0, 20.0
_DECODED = 60
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
    """The walking session, live at the pace of the clock, and as fast as the recorded pipeline goes."""
    scene = walking_scene(1, _QUICK_S if context.quick else _FULL_S)
    folder = rendered("walking-1", scene, context)
    blocks: list[Block] = []
    live = live_times(folder, context, _QUICK_LIVE_S if context.quick else _LIVE_S, scene.duration_s)
    alone_ms = {name: decode_ms(SessionPaths(folder).video(name)) for name in live.cameras}
    figures: dict[str, Any] = {"live": live_figures(live, alone_ms)}
    blocks += live_blocks(live, figures["live"])
    clock = SpikeClock()
    done = run_scene("walking-1", scene, context, clock)
    recorded, shown = recorded_blocks(clock, len(done.recording.rig))
    return Outcome(figures | recorded, Page("Latency", [*blocks, *shown]))


def decode_ms(film: Path) -> float:
    """Mean time per image of decoding the first images of a video, with nothing else to do."""
    began_s = time.perf_counter()
    count = sum(1 for _ in itertools.islice(read_video(film), _DECODED))
    return 1000 * (time.perf_counter() - began_s) / max(count, 1)


def recorded_blocks(clock: SpikeClock, cameras: int) -> tuple[dict[str, Any], list[Block]]:
    """Figures of the recorded pipeline, and a table and plots of its time steps."""
    spans = {stage: np.array([(begin, took) for name, begin, took in clock.spans if name == stage]) for stage in _STAGES}
    per_instant = {stage: 1000 * _per_instant(spans[stage], spans["decode"][:, 0]) for stage in _STAGES}
    total = np.sum(list(per_instant.values()), axis=0)
    stages = {
        "decode (wait for the next images)": per_instant["decode"],
        "2D pose, all cameras": per_instant["detect"],
        "2D pose, per image": per_instant["detect"] / cameras,
        "associate and fuse": per_instant["fuse"],
        "images to skeleton": total,
    }
    figures: dict[str, Any] = {
        "cameras": cameras,
        "time_steps": len(total),
        "stages_ms": {name: spread(ms) for name, ms in stages.items()},
        "second_pass_ms": 1000 * clock.seconds["smooth"] / len(total),
        "time_steps_per_s": float(1000 / total.mean()),
        "paper_ms": {"capture": paper.CAPTURE_MS, "2D pose": list(paper.DETECT_MS), "triangulation": paper.TRIANGULATE_MS},
    }
    rows = [[name, *spread_ms.values()] for name, spread_ms in figures["stages_ms"].items()]
    rows.append(["track: second pass", None, figures["second_pass_ms"], None, None])
    instants = np.arange(len(total), dtype=float)
    every = [Line(name, instants, ms) for name, ms in per_instant.items()]
    return figures, [
        Heading(
            "Recorded: time per stage",
            "The same images as `posefuse track` takes them, all cameras of one time step together and as fast as possible: no "
            "capture, and decoding runs ahead in threads, so its time is the remaining wait. The second pass (track: left/right "
            "swap correction, joint centres, smoothing) takes the whole recording at once; its time is shared by all steps.",
        ),
        Table(["stage", "median ms", "mean ms", "p95 ms", "most ms"], rows),
        Facts({"time steps per second": figures["time_steps_per_s"]}),
        Plots(
            [
                Plot("Spikes", _spikes(spans), x_label="s of the run", y_label="ms"),
                Plot("Every time step", every, x_label="time step", y_label="ms", from_zero=True),
            ]
        ),
    ]


def _per_instant(spans: Array, begins_s: Array) -> Array:
    """Seconds (T,) that blocks took between one time step's begin and the next's; the last decode found nothing more."""
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
