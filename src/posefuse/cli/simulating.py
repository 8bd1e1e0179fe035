"""What `posefuse simulate` does around the simulator: progress and the table at the end."""

from __future__ import annotations

import argparse
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.core import InputError
from posefuse.formats.truth import read_truth
from posefuse.simulation.scene import read_scene
from posefuse.simulation.session import SessionPaths, simulate

from .terminal import Terminal


def simulate_session(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Render a scene file into a session folder; returns the figures of the table."""
    scene = read_scene(args.scene)
    if args.force:
        _remove_session(args.out)
    began_s = time.perf_counter()
    try:
        with terminal.progress("rendering") as advance:
            paths = simulate(scene, args.out, advance, args.workers)
    except KeyboardInterrupt:
        terminal.warn(f"{args.out} is unfinished; the same command goes on where it stopped")
        raise
    seconds = time.perf_counter() - began_s
    truth = read_truth(paths.truth)
    frames = sum(len(view.t_ns) for view in truth.views)
    videos = [path for path in paths.videos.rglob("*") if path.is_file()]
    figures = {
        "cameras": list(truth.rig.names),
        "people": len(truth.person_id),
        "frames": frames,
        "duration_s": scene.duration_s,
        "seconds": seconds,
        "frames_per_s": frames / seconds,
        "megabytes": sum(path.stat().st_size for path in videos) / 1e6,
        "out": paths.folder,
    }
    terminal.facts(
        "Simulated",
        {
            "cameras": ", ".join(truth.rig.names),
            "people": figures["people"],
            "frames": frames,
            "recording": f"{scene.duration_s:g} s, {figures['megabytes']:.1f} MB",
            "rendered in": f"{seconds:.1f} s ({figures['frames_per_s']:.1f} frames/s)",
            "session": str(paths.folder),
            "next": f"posefuse track {paths.folder} --out {paths.folder.name}-result",
        },
    )
    return figures


def _remove_session(folder: Path) -> None:
    """Remove an earlier session, and nothing that is not one."""
    paths = SessionPaths(folder)
    if not folder.exists():
        return
    if not (paths.scene.is_file() or paths.incomplete.is_file() or not any(folder.iterdir())):
        raise InputError(f"{folder}: --force removes simulated sessions only, and this folder holds something else")
    shutil.rmtree(folder)
