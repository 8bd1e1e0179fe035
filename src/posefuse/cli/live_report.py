"""Figures of a live session: tables on the terminal, latency.json, and pictures of where the time went."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse import __version__
from posefuse.core import InputError
from posefuse.foundation.output_folder import output_folder
from posefuse.foundation.plain_values import plain
from posefuse.realtime.latency import STAGES
from posefuse.realtime.session_plan import Finished

from .terminal import Terminal

_TOP_OF_P95 = 2.0
JSON_FILE, TABLE_FILE, PAGE_FILE = "latency.json", "latency.md", "latency.html"


def figures_of(done: Finished) -> dict[str, Any]:
    """Everything as plain values."""
    fusion = done.fusion
    cameras: dict[str, dict[str, Any]] = {}
    for name in fusion.rig.names:
        source = fusion.monitor.source(name)
        captured = source.captured if source else 0
        health = fusion.tracker.health[name]
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
        "poses_per_s": fusion.latencies.rate_hz,
        "joint_centres": fusion.centring.made_by,
        "used_share": sum(fusion.used.values()) / captured if captured else float("nan"),
        "cpu_fusion_share": done.cpu_s[0] / done.seconds,
        "cpu_children_share": done.cpu_s[1] / done.seconds,
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


def show(terminal: Terminal, figures: Mapping[str, Any]) -> None:
    """The tables a person reads."""
    latency = figures["latency"]
    rows = [
        [
            name, camera["state"], f"{camera['used_share']:.0%}" if camera["captured"] else "-",
            *(f"{latency['cameras_ms'][name][stage]['p50']:.1f}" for stage in STAGES),
            *(f"{latency['cameras_ms'][name]['total'][share]:.0f}" for share in ("p95", "p99")),
        ]
        for name, camera in figures["cameras"].items()
    ]  # fmt: skip
    terminal.table(
        "Median ms per stage from exposure to output, and of the total p95 and p99",
        ("camera", "state", "used", *STAGES, "p95", "p99"),
        rows,
    )
    whole, beat = latency["all_cameras_total_ms"], latency["output"]
    facts = {
        "poses": f"{figures['poses']} ({figures['poses_per_s']:.1f}/s), with somebody in {figures['poses_with_people']}",
        "exposure to output": f"p50 {whole['p50']:.1f}, p95 {whole['p95']:.1f}, p99 {whole['p99']:.1f} ms",
        "output beat": (
            f"p99 {beat['behind_due_ms']['p99']:.2f} ms behind due, {beat['period_deviation_ms']['p99']:.2f} ms off the period, "
            f"{beat['skipped']} skipped"
        ),
        "processor": f"fusion {figures['cpu_fusion_share']:.0%}, the rest {figures['cpu_children_share']:.0%} of a core",
        "memory": f"{figures['memory_mb']:.0f} MB at most, fusion and cameras",
    }
    if figures["joint_centres"]:
        facts["joint centres"] = "; ".join(sorted(set(figures["joint_centres"].values())))
    if math.isfinite(figures["used_share"]):
        facts["frames used"] = f"{figures['used_share']:.0%}"
    if figures["restarts"]:
        facts["restarts"] = str(figures["restarts"])
    for name, output in figures["outputs"].items():
        fault = f"; failed {output['failures']} times, the last: {output['fault']}" if output["failures"] else ""
        facts[f"output {name}"] = f"{output['taken']} taken, {output['dropped']} dropped{fault}"
    for name, video in figures.get("videos", {}).items():
        fault = f"; {video['fault']}" if video["fault"] else ""
        facts[f"video {name}"] = f"{video['written']} frames {video['how']}, {video['dropped']} dropped{fault}"
    if figures["outputs_lost"]:
        facts["outputs"] = f"{figures['outputs_lost']} messages lost before they reached an output"
    if figures["rig_watch_trouble"]:
        facts["rig watch"] = figures["rig_watch_trouble"]
    terminal.facts("Session", facts)


def write_report(folder: Path, done: Finished, figures: Mapping[str, Any]) -> None:
    """latency.json, latency.md and latency.html (the newest views' latencies over time) into `folder`."""
    content = {"posefuse": __version__, "rig_id": done.fusion.rig.id, **figures}
    try:
        with output_folder(folder, command="live") as out:
            (out.folder / JSON_FILE).write_text(json.dumps(plain(content), indent=2) + "\n", encoding="utf-8")
            (out.folder / TABLE_FILE).write_text(_markdown(figures), encoding="utf-8")
            (out.folder / PAGE_FILE).write_text(_page(done, figures), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder}: the report cannot be written ({error.strerror})") from None


def _markdown(figures: Mapping[str, Any]) -> str:
    head = "| camera | stage | n | mean | p50 | p95 | p99 | max |"
    lines = ["# Latency per camera and stage, ms", "", head, "|---" * 8 + "|"]
    for name, stages in figures["latency"]["cameras_ms"].items():
        for stage in STAGES:
            row = stages[stage]
            numbers = " | ".join(f"{row[key]:.1f}" for key in ("mean", "p50", "p95", "p99", "max"))
            lines.append(f"| {name} | {stage} | {row['n']} | {numbers} |")
    lines += ["", "# What happened", "", "| s | camera | state | |", "|---|---|---|---|"]
    lines += [f"| {event['t_s']:.2f} | {event['camera']} | {event['state']} | {event['text']} |" for event in figures["events"]]
    if figures["output_events"]:
        lines += ["", "| s | output | state | |", "|---|---|---|---|"]
        lines += [f"| {one['t_s']:.2f} | {one['output']} | {one['state']} | {one['text']} |" for one in figures["output_events"]]
    return "\n".join(lines) + "\n"


def _page(done: Finished, figures: Mapping[str, Any]) -> str:
    """The paper's spike plot: one spike per view, as high as its latency; the dashed line is the camera's mean."""
    views = [(way.exposed_ns / 1e9, way.camera, (out_ns - way.exposed_ns) / 1e6) for way, out_ns in done.fusion.latencies.newest]
    if not views:
        return "<!doctype html><title>Latency</title><p>No view reached an output.</p>\n"
    zero_s = done.zero_ns / 1e9
    first = min(t for t, _, _ in views) - zero_s
    span_s = (first, max(max(t for t, _, _ in views) - zero_s, first + 1e-3))
    # one scale for all cameras, which a single late view does not flatten
    top_ms = _TOP_OF_P95 * float(np.percentile([ms for _, _, ms in views], 95))
    parts = []
    for name in done.fusion.rig.names:
        spikes = [(t - zero_s, ms) for t, camera, ms in views if camera == name]
        mean_ms = figures["latency"]["cameras_ms"][name]["total"]["mean"]
        parts.append(f"<h3>{html.escape(name)}</h3>{_spikes(spikes, span_s, top_ms, mean_ms)}")
    return (
        '<!doctype html><meta charset="utf-8"><title>Latency</title>'
        "<style>body{font:14px sans-serif;margin:2em}h3{margin:1em 0 0}svg text{font:12px sans-serif}</style>"
        "<h1>From exposure to output</h1><p>One spike per view, the newest "
        f"{len(views)} of all cameras; dashed: the camera's mean over the whole session; red: higher than drawn.</p>"
        f"{''.join(parts)}\n"
    )


def _spikes(spikes: list[tuple[float, float]], span_s: tuple[float, float], top_ms: float, mean_ms: float) -> str:
    left, width, height, below = 60, 900, 110, 20
    first_s, last_s = span_s

    def x(t_s: float) -> float:
        return left + (t_s - first_s) / (last_s - first_s) * width

    def y(ms: float) -> float:
        return height * (1 - min(ms, top_ms) / top_ms)

    def path(chosen: list[tuple[float, float]], colour: str) -> str:
        return f'<path stroke="{colour}" d="{"".join(f"M{x(t):.1f} {height}V{y(ms):.1f}" for t, ms in chosen)}"/>'

    parts = [path([one for one in spikes if one[1] <= top_ms], "#36c"), path([one for one in spikes if one[1] > top_ms], "#c33")]
    parts += [
        f'<path stroke="#ddd" d="M{left} {y(ms):.1f}H{left + width}"/><text x="0" y="{y(ms) + 10:.1f}">{ms:.0f} ms</text>'
        for ms in (top_ms, top_ms / 2)
    ]
    parts += [f'<text x="{x(t):.0f}" y="{height + 15}">{t:.1f} s</text>' for t in (first_s, (first_s + last_s) / 2)]
    if spikes:
        parts.append(f'<path stroke="#222" stroke-dasharray="6 4" d="M{left} {y(mean_ms):.1f}H{left + width}"/>')
        highest = max(ms for _, ms in spikes)
        parts.append(f'<text x="{left + width - 230}" y="{height + 15}">mean {mean_ms:.1f} ms, highest {highest:.1f} ms</text>')
    return f'<svg width="{left + width}" height="{height + below}" fill="none">{"".join(parts)}</svg>'.replace(
        "<text ", '<text fill="#222" '
    )
