"""Figures of a live session: tables on the terminal, latency.json, and plots of the latency of every stage."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from posefuse import __version__
from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.formats.page import Heading, Line, Note, Page, Plot, Plots, Series, Spikes, write_page
from posefuse.foundation.output_folder import output_folder
from posefuse.foundation.parsing import plain
from posefuse.realtime.fusion import Fusion
from posefuse.realtime.latency import STAGES
from posefuse.realtime.session import Finished

from .terminal import Terminal

_TOP_OF_P95 = 2.0
JSON_FILE, PAGE_FILE = "latency.json", "latency.html"


def _lengths(fusion: Fusion) -> dict[int, dict[str, dict[str, float]]]:
    """By person and segment, what the whole-body fit learnt; nothing where it is off."""
    people = {} if fusion.estimator.bodies is None else fusion.estimator.bodies.lengths
    return {person: {name: asdict(length) for name, length in lengths.items()} for person, lengths in people.items()}


def live_session_figures(done: Finished) -> dict[str, Any]:
    """Everything as plain values."""
    fusion = done.fusion
    cameras: dict[str, dict[str, Any]] = {}
    for name in fusion.rig.names:
        source = fusion.monitor.source(name)
        captured = source.captured if source else 0
        health = fusion.estimator.tracker.health[name]
        verdict = fusion.verdicts.get(name)
        cameras[name] = {
            "state": verdict.state if verdict else "opening",
            "captured": captured,
            "used": fusion.used[name],
            "used_share": fusion.used[name] / captured if captured else float("nan"),
            "replaced": source.replaced if source else 0,
            "missing": source.missing if source else 0,
            "refused": fusion.monitor.refused(name),
            "innovation_sigmas": health.innovation_sigmas,
            "gated_share": health.gated_share,
            "late": health.late,
        }
    captured = sum(camera["captured"] for camera in cameras.values())
    return {
        "seconds": done.seconds,
        "stopped_by": done.stopped_by,
        "zero_ns": done.zero_ns,
        "poses": fusion.poses,
        "poses_with_people": fusion.poses_with_people,
        "withheld": fusion.estimator.gate.figures(),
        "poses_per_s": fusion.latencies.rate_hz,
        "joint_centres": fusion.estimator.centring.made_by,
        "segment_lengths": _lengths(fusion),
        "used_share": sum(fusion.used.values()) / captured if captured else float("nan"),
        # a session that is stopped while it starts has not begun
        "cpu_fusion_share": done.cpu_s[0] / done.seconds if done.seconds > 0 else float("nan"),
        "cpu_children_share": done.cpu_s[1] / done.seconds if done.seconds > 0 else float("nan"),
        "memory_mb": done.memory_mb,
        "restarts": done.restarts,
        "outputs": done.outputs,
        "outputs_lost": done.lost,
        "output_events": [
            {"t_s": (event.t_ns - done.zero_ns) / 1e9, "output": event.output, "state": event.state, "text": event.text}
            for event in done.output_events
        ],
        "failed": [name for name, output in done.outputs.items() if output["failures"]],
        "rig_watch_trouble": fusion.watch.trouble if fusion.watch is not None else "",
        "cameras": cameras,
        "events": [
            {"t_s": (event.t_ns - done.zero_ns) / 1e9, "camera": event.camera, "state": event.state, "text": event.text}
            for event in fusion.monitor.events
        ],
        "latency": fusion.latencies.figures(),
    }


def show_live_figures(terminal: Terminal, figures: Mapping[str, Any]) -> None:
    """The tables a person reads."""
    latency = figures["latency"]
    rows = [
        [
            name, camera["state"], f"{camera['used_share']:.0%}" if camera["captured"] else "-",
            *(_number(latency["cameras_ms"][name][stage]["p50"], 1) for stage in STAGES),
            *(_number(latency["cameras_ms"][name]["total"][share], 0) for share in ("p95", "p99")),
        ]
        for name, camera in figures["cameras"].items()
    ]  # fmt: skip
    terminal.table(
        "Median ms per stage from exposure to output, and of the total p95 and p99",
        ("camera", "state", "used", *STAGES, "p95", "p99"),
        rows,
    )
    whole, ticks = latency["all_cameras_total_ms"], latency["output"]
    facts = {
        "poses": f"{figures['poses']} ({_number(figures['poses_per_s'], 1)}/s), with a person in {figures['poses_with_people']}"
    }
    if figures["poses"]:
        facts |= {
            "exposure to output": ", ".join(f"{p} {_number(whole[p], 1)}" for p in ("p50", "p95", "p99")) + " ms",
            "output rate": (
                f"p99 {_number(ticks['behind_due_ms']['p99'], 2)} ms behind due, "
                f"{_number(ticks['period_deviation_ms']['p99'], 2)} ms off the period, {ticks['skipped']} skipped"
            ),
            "processor": (
                f"fusion {figures['cpu_fusion_share']:.0%} of a core, "
                f"the rest {figures['cpu_children_share']:.0%} with the start of their processes"
            ),
            "memory": f"{figures['memory_mb']:.0f} MB at most, fusion and cameras",
        }
    if any(figures["withheld"].values()):
        cut = figures["withheld"]
        facts["withheld"] = f"{cut['keypoints']:.1%} of keypoints, {cut['people']:.1%} of people: too unsure, or not measured"
    if figures["joint_centres"]:
        facts["joint centres"] = "; ".join(f"offsets of {table}" for table in sorted(set(figures["joint_centres"].values())))
    if math.isfinite(figures["used_share"]):
        facts["frames used"] = f"{figures['used_share']:.0%}"
    if figures["restarts"]:
        facts["restarts"] = str(figures["restarts"])
    for name, output in figures["outputs"].items():
        fault = f"; failed {output['failures']} times, the last: {output['fault']}" if output["failures"] else ""
        facts[f"output {name}"] = f"{output['taken']} taken, {output['dropped']} dropped{fault}"
    for name, video in figures.get("videos", {}).items():
        fault = f"; {video['fault']}" if video["fault"] else ""
        facts[f"video {name}"] = f"{video['written']} frames {video['how'] or 'written'}, {video['dropped']} dropped{fault}"
    if figures["outputs_lost"]:
        facts["outputs"] = f"{figures['outputs_lost']} messages lost before they reached an output"
    if figures["rig_watch_trouble"]:
        facts["rig watch"] = figures["rig_watch_trouble"]
    terminal.facts("Session", facts)


def _number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def write_latency_report(folder: Path, done: Finished, figures: Mapping[str, Any]) -> None:
    """latency.json and latency.html (the newest views' latencies over time) into `folder`."""
    content = {"posefuse": __version__, "rig_id": done.fusion.rig.id, **figures}
    try:
        with output_folder(folder, command="live") as out:
            (out.folder / JSON_FILE).write_text(json.dumps(plain(content), indent=2) + "\n", encoding="utf-8")
            write_page(out.folder / PAGE_FILE, latency_page(done, figures))
    except OSError as error:
        raise InputError(f"{folder}: the report cannot be written ({error.strerror})") from None


def latency_page(done: Finished, figures: Mapping[str, Any]) -> Page:
    """One spike per view, as high as its latency, over the session; the dashed line is the camera's mean."""
    views = [(way.camera, (way.exposed_ns - done.zero_ns) / 1e9, (out_ns - way.exposed_ns) / 1e6)
             for way, out_ns in done.fusion.latencies.newest]  # fmt: skip
    title = "Latency from exposure to output"
    if not views:
        return Page(title, [Note("No view reached an output.")])
    t_s = np.array([t for _, t, _ in views])
    # one scale for all cameras, which a single late view does not flatten
    top_ms = _TOP_OF_P95 * float(np.percentile([ms for _, _, ms in views], 95))
    window = (float(t_s.min()), max(float(t_s.max()), float(t_s.min()) + 1e-3), 0.0, top_ms)
    text = (
        f"One spike per view, the newest {len(views)} of all cameras; dashed: the camera's mean over the whole session; "
        "red: higher than drawn, zoom out to see all of it."
    )
    plots = []
    for name in done.fusion.rig.names:
        own = np.array([(t, ms) for camera, t, ms in views if camera == name]).reshape(-1, 2)
        mean_ms = figures["latency"]["cameras_ms"][name]["total"]["mean"]
        said = f"mean {mean_ms:.1f} ms, highest {own[:, 1].max():.1f} ms" if len(own) else "no view"
        plots.append(_spike_plot(f"{name}: {said}", own, mean_ms, window))
    return Page(title, [Heading("One spike per view", text), Plots(plots)])


def _spike_plot(title: str, views: Array, mean_ms: float, window: tuple[float, float, float, float]) -> Plot:
    """Views (n, 2) of a camera: seconds and milliseconds."""
    high = views[:, 1] > window[3]
    zero = np.zeros(len(views))
    series: list[Series] = [
        Spikes(name, views[chosen, 0], zero[chosen], views[chosen, 1], colour=colour)
        for name, chosen, colour in (("latency", np.invert(high), "c0"), ("higher than drawn", high, "bad"))
    ]
    if len(views):
        series.append(Line("mean", np.array(window[:2]), np.full(2, mean_ms), colour="ink", dashed=True))
    return Plot(title, series, x_label="s of the session", y_label="ms", window=window, wide=True, legend=False)
