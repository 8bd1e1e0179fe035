"""What `posefuse simulate` does around the simulator and the Gazebo export: progress and the table at the end."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.api.plan import plan
from posefuse.formats.truth import read_truth
from posefuse.foundation.output_folder import find_unfinished
from posefuse.foundation.places import check_outside_inputs
from posefuse.simulation.gazebo import export_world
from posefuse.simulation.scene import motion_files, read_scene
from posefuse.simulation.session import simulate

from .terminal import Terminal


def simulate_session(scene_file: Path, out: Path, force: bool, workers: int | None, terminal: Terminal) -> Mapping[str, Any]:
    """Render a scene file into a session folder, again with `force`; returns the figures of the table."""
    scene = read_scene(scene_file)
    check_outside_inputs(out, (scene_file, *motion_files(scene)))
    began_s = time.perf_counter()
    try:
        with terminal.progress("rendering") as advance:
            paths = simulate(scene, out, advance, workers, replace=force, warn=terminal.warn)
    except KeyboardInterrupt:
        if find_unfinished(out):
            terminal.warn(f"{out}: what was rendered is kept; the same command continues where it stopped")
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
        },
    )
    terminal.next(f"posefuse track {paths.folder} --out {paths.folder.name}-result", "the 3D skeleton, compared with the truth")
    return figures


def show_plan(scene_file: Path, terminal: Terminal) -> Mapping[str, Any]:
    """Coverage and expected error of a scene's cameras; returns the figures of the table."""
    found = plan(scene_file)
    figures = {
        "area_m": [float(np.ptp(found.x_m)), float(np.ptp(found.y_m))],
        "heights_m": found.height_m.tolist(),
        "covered_by_2": found.covered(2),
        "covered_by_3": found.covered(3),
        "median_mm": found.error_at(0.5),
        "p95_mm": found.error_at(0.95),
    }
    (width_m, depth_m), (lowest_m, highest_m) = figures["area_m"], found.height_m[[0, -1]]
    terminal.facts(
        "Expected of these cameras",
        {
            "floor": f"{width_m:.1f} x {depth_m:.1f} m, {lowest_m:g} to {highest_m:g} m high",
            "seen by 2 cameras or more": f"{figures['covered_by_2']:.0%}",
            "seen by 3 cameras or more": f"{figures['covered_by_3']:.0%}",
            "keypoint error, one time step": f"median {figures['median_mm']:.0f} mm, 95 % below {figures['p95_mm']:.0f} mm",
        },
    )
    terminal.next(f"posefuse simulate {scene_file} --out DIR", "a test walk, rendered, with its exact truth")
    return figures


def write_gazebo_world(scene_file: Path, out: Path, release: str, force: bool, terminal: Terminal) -> Mapping[str, Any]:
    """Write a scene file as a Gazebo world, again with `force`; returns the figures of the table."""
    scene = read_scene(scene_file)
    check_outside_inputs(out, (scene_file, *motion_files(scene)))
    terminal.note(f"writing {scene.duration_s:g} s of motion, its meshes and its truth: minutes for a long scene")
    world = export_world(scene, out, release=release, replace_older=force, warn=terminal.warn)
    for line in world.left_out:
        terminal.warn(line)
    size = sum(path.stat().st_size for path in world.folder.rglob("*") if path.is_file())
    figures = {
        "cameras": list(world.rig.names),
        "people": world.people,
        "loop_s": world.loop_s,
        "keys_hz": list(world.keys_hz),
        "megabytes": size / 1e6,
        "out": world.folder,
    }
    keys = ", ".join(f"{rate:.0f}" for rate in world.keys_hz)
    terminal.facts(
        "Gazebo world",
        {
            "for": release,
            "cameras": ", ".join(world.rig.names),
            "people": world.people,
            "motion": f"{world.loop_s:g} s, again and again; keys per second: {keys or 'none'}",
            "size": f"{figures['megabytes']:.1f} MB",
            "folder": str(world.folder),
        },
    )
    terminal.next(f"{world.folder}/launch.sh", "Gazebo and the bridge to ROS 2; docs/gazebo.md continues from there")
    return figures
