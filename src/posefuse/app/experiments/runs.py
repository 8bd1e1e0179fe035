"""What every experiment needs: rendered sessions, the pipeline run on them, pictures, the machine."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from posefuse import __version__
from posefuse.app.config import TrackConfig, read_config
from posefuse.app.detectors import build_detector
from posefuse.app.recorded.clock import StageClock
from posefuse.app.recorded.run import build_source, track_session
from posefuse.app.recorded.second_pass import poses_over_time, views_of
from posefuse.app.session import UNFINISHED_FILE, find_session
from posefuse.app.terminal import Terminal
from posefuse.core import PoseSequence, Recording, Truth
from posefuse.core.arrays import Array
from posefuse.evaluate.experiments.page import Page
from posefuse.evaluate.experiments.scenes import scene_name
from posefuse.evaluate.metrics import JointErrors, joint_errors
from posefuse.files.truth import read_truth
from posefuse.simulate.scene import Scene
from posefuse.simulate.session import simulate
from posefuse.track import JointCentres, read_joint_centres

_PACKAGES = ("numpy", "openvino", "mujoco", "anny", "opencv-contrib-python-headless")


@dataclass(frozen=True)
class Context:
    """Where and how experiments run.

    Attributes:
        sessions: rendered sessions are kept and found here. quick: seconds of everything instead of the paper's length.
        workers: processes that render; None takes one per core. command: as typed, for the reports.
        overrides: ``KEY=VALUE`` settings of the pipeline in place of its defaults, as `posefuse track --set` takes them.
    """

    sessions: Path
    quick: bool
    workers: int | None
    command: str
    terminal: Terminal
    overrides: tuple[str, ...] = ()

    @property
    def config(self) -> TrackConfig:
        """How every scene is tracked; raises ConfigError for overrides that cannot be."""
        return replace(read_config(None, self.overrides), outputs=())


@dataclass(frozen=True, eq=False)
class Outcome:
    """What an experiment found: plain figures, and the page that shows them."""

    figures: Mapping[str, Any]
    page: Page


@dataclass(frozen=True, eq=False)
class Run:
    """A rendered session, tracked.

    Attributes:
        folder: the session. config: it was tracked with. recording: the result `posefuse track` gives. truth: exact.
        centres: the table of the 2D estimator.
    """

    folder: Path
    config: TrackConfig
    recording: Recording
    truth: Truth
    centres: JointCentres | None

    def poses(self, weights: str = "robust", smoothed: bool = True, centred: bool = True) -> PoseSequence:
        """The same 2D, fused in another way."""
        return poses_over_time(
            views_of(self.recording),
            self.recording.rig,
            replace(self.config.fuse, weights=weights),  # type: ignore[arg-type]
            self.config.smooth if smoothed else None,
            self.centres if centred else None,
        )

    def errors(self, weights: str = "robust", smoothed: bool = True, centred: bool = True) -> JointErrors:
        """Distances from the truth of `poses`."""
        return joint_errors(self.poses(weights, smoothed, centred), self.truth)

    def default_errors(self) -> JointErrors:
        """Distances from the truth of what `posefuse track` gives with these settings."""
        return joint_errors(self.recording.poses, self.truth)


def run_scene(name: str, scene: Scene, context: Context, clock: StageClock | None = None) -> Run:
    """Render a scene, unless it lies there already, and track it as the context says."""
    config = context.config
    folder = rendered(name, scene, context)
    session = find_session(folder, config)
    with context.terminal.progress(f"tracking {name}") as advance:
        tracked = track_session(session, config, clock or StageClock(), advance, context.terminal.note, context.terminal.warn)
    file = getattr(build_detector(config.detector, tracked.recording.rig), "joint_centres_file", None)
    centres = read_joint_centres(file) if file and config.joint_centres else None
    return Run(folder, config, tracked.recording, read_truth(folder / "truth" / "truth.npz"), centres)


def rendered(name: str, scene: Scene, context: Context) -> Path:
    """The session of a scene; rendered where it is not there yet, finished where an earlier run broke off."""
    folder = context.sessions / scene_name(name, scene)
    if not (folder / "truth" / "truth.npz").is_file() or (folder / UNFINISHED_FILE).exists():
        with context.terminal.progress(f"rendering {name}") as advance:
            simulate(scene, folder, advance, context.workers)
    return folder


def about(context: Context) -> dict[str, Any]:
    """The machine, the versions and the command of a report."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return {
        "machine": f"{names[0] if names else platform.processor()}, {len(os.sched_getaffinity(0))} cores",
        "versions": ", ".join(
            [f"posefuse {__version__}", f"Python {platform.python_version()}", *(f"{p} {version(p)}" for p in _PACKAGES)]
        ),
        "command": context.command,
        "settings": ", ".join(context.overrides) or "defaults",
        "length": "quick: seconds of everything" if context.quick else "full",
    }


def pictures(run: Run, camera: int, instants: Sequence[int], width_px: int = 480) -> dict[str, Array]:
    """Captions to pictures of one camera at instants of the recording, with the fused skeleton drawn in."""
    from posefuse.sinks.drawing import view_tile

    config = TrackConfig()
    recording = run.recording
    name = recording.rig.names[camera]
    session = find_session(run.folder, config)
    source = build_source(next(entry for entry in session.inputs if entry.camera == name), config)
    width, height = source.size_wh
    wanted = {int(i): recording.poses.t_ns[i] for i in instants}
    images: dict[int, Array] = {}
    try:
        for frame in source.frames():
            for i, t_ns in wanted.items():
                if i not in images and frame.t_ns >= t_ns - 1_000_000:
                    images[i] = np.array(frame.image)
            if len(images) == len(wanted):
                break
    finally:
        source.close()
    tile_wh = (width_px, round(width_px * height / width))
    return {
        f"{name}, {recording.poses.t_ns[i] / 1e9:.1f} s": view_tile(recording, i, camera, image, tile_wh)
        for i, image in sorted(images.items())
    }


def errors_row(errors: JointErrors) -> dict[str, Any]:
    """Plain figures of a column of the tables."""
    return {
        "mean_mm": errors.mpjpe_mm,
        "worst_joint": errors.joints[int(np.nanargmax(errors.mean_mm))],
        "worst_mm": float(np.nanmax(errors.mean_mm)),
        "found": float(errors.found.mean()),
        "joints": {
            joint: {"mean_mm": float(errors.mean_mm[i]), "sd_mm": float(errors.sd_mm[i]), "p95_mm": float(errors.p95_mm[i])}
            for i, joint in enumerate(errors.joints)
        },
    }


def joint_table(
    page: Page, columns: Mapping[str, Mapping[str, Any]], paper: Mapping[str, Mapping[str, tuple[float, float]]]
) -> None:
    """The paper's layout: 14 joints, mean +- sd per column, ours and then the paper's, averages below."""
    first = next(iter(columns.values()))["joints"]
    rows: list[list[str]] = []
    for joint in first:
        ours = [f"{c['joints'][joint]['mean_mm']:.1f} ± {c['joints'][joint]['sd_mm']:.1f}" for c in columns.values()]
        theirs = [f"{c[joint][0]:.1f} ± {c[joint][1]:.1f}" for c in paper.values()]
        rows.append([joint.replace("_", " "), *ours, *theirs])
    averages = [f"{c['mean_mm']:.2f}" for c in columns.values()]
    averages += [f"{np.mean([mean for mean, _ in c.values()]):.2f}" for c in paper.values()]
    rows.append(["average", *averages])
    page.table(["joint (mm)", *columns, *(f"paper: {name}" for name in paper)], rows)
