"""The part of the latency page that shows a live session."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from paper.scenes import paper
from posefuse.core import Array
from posefuse.formats.page import Block, Facts, Heading, Line, Plot, Plots, Spikes, Table

from .live_times import SETTLED_S, STAGES, LiveTimes

_SPIKES_S = 1.0
_TEXT = (
    "The video of every camera, played in real time into `posefuse live`; every view is stamped on one clock. capture: from "
    "mid-exposure until the decoded image is in its process (decoding included; a real camera adds readout and transport). "
    "wait: for the detector to be free. 2D: the detector. fuse, track: to the fusion process and into the tracker, which takes "
    "views one by one. output: until the next output tick (100 Hz) has its pose. send: until another program has received it by "
    f"UDP. The first {SETTLED_S:g} s, in which the person is searched for, are left out."
)


def live_figures(live: LiveTimes, alone_ms: Mapping[str, float]) -> dict[str, Any]:
    """Times per camera and stage.

    Args:
        live: a session. alone_ms: per camera, decoding one image with nothing else to do.
    """
    stages, total = live.stages_ms, live.total_ms
    cameras = {}
    for c, name in enumerate(live.cameras):
        own = live.camera == c
        if own.any():
            cameras[name] = {
                "views": int(own.sum()),
                "decode_alone_ms": alone_ms[name],
                "stages_ms": {stage: spread(stages[own, s]) for s, stage in enumerate(STAGES)},
                "total_ms": spread(total[own]),
            }
    together = {stage: spread(stages[:, s]) for s, stage in enumerate(STAGES)} | {"total": spread(total)}
    return {"used_share": live.used_share, "output_hz": live.output_hz, "all_cameras_ms": together, "cameras": cameras}


def live_blocks(live: LiveTimes, figures: Mapping[str, Any]) -> list[Block]:
    """Averages per camera as a table with those of the paper, spikes over time."""
    cameras = figures["cameras"]
    theirs = [
        [f"paper, {name} GPU", paper.CAPTURE_MS, 0.0, ms, paper.TRIANGULATE_MS, 0.0, 0.0, *[None] * 5]
        for name, ms in zip(("best", "slowest"), paper.DETECT_MS, strict=True)
    ]
    return [
        Heading("Live: from exposure to another program, averages per camera", _TEXT),
        Table(
            ["mean ms", *STAGES, "end to end", "p95", "most", "views", "decoding alone"],
            [
                [name, *_means(one), *(one["total_ms"][key] for key in ("mean", "p95", "most")), one["views"],
                 one["decode_alone_ms"]]
                for name, one in cameras.items()
            ]
            + theirs,
        ),
        Facts(
            {
                "views used": f"{100 * live.used_share:.0f} % of the frames; when the processor is busy the newest frame wins",
                "poses": f"{live.output_hz:.1f} per second (paper: {paper.OUTPUT_HZ:g})",
                "paper: capture": f"{paper.CAPTURE_MS:g} ms, a whole period of its cameras",
                "paper: 2D pose": f"{paper.DETECT_MS[0]:g} to {paper.DETECT_MS[1]:g} ms on three GPUs",
                "paper: triangulation": f"< {paper.TRIANGULATE_MS:g} ms",
            }
        ),
        Heading(
            "Live: spikes over time",
            "One spike per view, at its exposure and as high as its latency, its stages on top of each other; one second in the "
            "middle.",
        ),
        Plots(_spike_plots(live)),
    ]  # fmt: skip


def _spike_plots(live: LiveTimes) -> list[Plot]:
    middle_s = float(np.median(live.passed_s[:, 0]))
    near = np.abs(live.passed_s[:, 0] - middle_s) <= _SPIKES_S / 2
    window = (middle_s - _SPIKES_S / 2, middle_s + _SPIKES_S / 2, 0.0, 1.05 * float(live.total_ms[near].max()))
    plots = [
        Plot(name, view_spikes(live, c, middle_s), x_label="s", y_label="ms", window=window)
        for c, name in enumerate(live.cameras)
    ]
    whole = "Exposure to another program, the whole run"
    return [*plots, Plot(whole, _totals(live), x_label="s", y_label="ms", from_zero=True, wide=True)]


def view_spikes(live: LiveTimes, camera: int, middle_s: float) -> list[Spikes]:
    """Per stage, its part of every spike of a camera within a second."""
    near = (live.camera == camera) & (np.abs(live.passed_s[:, 0] - middle_s) <= _SPIKES_S / 2)
    passed_s = live.passed_s[near]
    late_ms = 1000 * (passed_s - passed_s[:, :1])
    return [Spikes(stage, passed_s[:, 0], late_ms[:, s], late_ms[:, s + 1]) for s, stage in enumerate(STAGES)]


def spread(ms: Array) -> dict[str, float]:
    """Median, mean, 95th percentile and most."""
    return {
        "median": float(np.median(ms)),
        "mean": float(ms.mean()),
        "p95": float(np.percentile(ms, 95)),
        "most": float(ms.max()),
    }


def _means(camera: Mapping[str, Any]) -> list[float]:
    return [camera["stages_ms"][stage]["mean"] for stage in STAGES]


def _totals(live: LiveTimes) -> list[Line]:
    return [
        Line(name, live.passed_s[live.camera == c, 0], live.total_ms[live.camera == c]) for c, name in enumerate(live.cameras)
    ]
