"""What every experiment needs: rendered sessions, the pipeline run on them, images, the machine."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console as RichConsole

from paper.scenes.scenes import CHECK_SEEDS, scene_name
from posefuse import __version__
from posefuse.core import JointCentres, PoseSequence, Progress, Recording, Truth
from posefuse.evaluation import JointErrors, joint_errors
from posefuse.formats import joint_centres_from_mapping, read_truth
from posefuse.formats.page import Block
from posefuse.foundation import plain, stage_bars, usable_cores
from posefuse.pipeline import (
    TrackConfig,
    changes_of,
    find_session,
    poses_over_time,
    read_config,
    track_session,
)
from posefuse_sim import Scene, simulate
from tools.page_marks import processor

BEST_NETWORKS, BEST_S = "blazepose_best", 20.0
DEVICE = "detector.options.device"
_PACKAGES = ("numpy", "openvino", "mujoco", "opencv-python-headless")


@dataclass(frozen=True)
class Context:
    """Where and how experiments run.

    Attributes:
        sessions: rendered sessions are kept and found here. quick: seconds of everything instead of the paper's length.
        workers: processes that render; None takes one per core. command: as typed, for the reports.
        overrides: ``KEY=VALUE`` settings of the pipeline in place of its defaults, as `posefuse track --set` takes them.
        devices: processors to compare, as `posefuse track --device` takes them; none: that of the settings.
    """

    sessions: Path
    quick: bool
    workers: int | None
    command: str
    console: Console
    overrides: tuple[str, ...] = ()
    devices: tuple[str, ...] = ()

    def each_device(self) -> dict[str, Context]:
        """By device, the same with its network there; "as set" where none is to be compared."""
        if not self.devices:
            return {"as set": self}
        return {word: replace(self, overrides=(*self.overrides, f"{DEVICE}={word}")) for word in self.devices}

    @property
    def config(self) -> TrackConfig:
        """How every scene is tracked; raises ConfigError for overrides that cannot be."""
        return replace(read_config(None, changes_of(self.overrides)), outputs={})


@dataclass(frozen=True, eq=False)
class Outcome:
    """What an experiment found: plain figures, of which its `report` makes tables, and the images and plots of its page."""

    title: str
    figures: Mapping[str, Any]
    blocks: Sequence[Block]


@dataclass(frozen=True, eq=False)
class Run:
    """A rendered session, tracked.

    Attributes:
        folder: the session. config: it was tracked with. recording: the result `posefuse track` gives. truth: exact.
        centres: the table of the detector.
    """

    folder: Path
    config: TrackConfig
    recording: Recording
    truth: Truth
    centres: JointCentres | None

    def poses(self, weights: str = "robust", smoothed: bool = True, centred: bool = True) -> PoseSequence:
        """The same 2D, fused in another way."""
        return poses_over_time(
            self.recording.views,
            self.recording.rig,
            replace(self.config.fuse, weights=weights),
            self.config.smooth if smoothed else None,
            self.centres if centred else None,
        )

    def errors(self, weights: str = "robust", smoothed: bool = True, centred: bool = True) -> JointErrors:
        """Distances from the truth of `poses`."""
        return joint_errors(self.poses(weights, smoothed, centred), self.truth)

    def default_errors(self) -> JointErrors:
        """Distances from the truth of what `posefuse track` gives with these settings."""
        return joint_errors(self.recording.poses, self.truth)


def run_scene(name: str, scene: Scene, context: Context) -> Run:
    """Render a scene, unless it exists already, and track it with the options of the context."""
    config = context.config
    folder = rendered(name, scene, context)
    session = find_session(folder, config)
    context.console.note(f"tracking {name}")
    with context.console.stages() as report:
        recording = track_session(session, config, progress=report).recording
    table = recording.provenance["joint_centres"]
    centres = joint_centres_from_mapping(table, "provenance: joint_centres") if table else None
    return Run(folder, config, recording, read_truth(folder / "truth" / "truth.npz"), centres)


def best_errors(name: str, scene: Scene, context: Context) -> dict[str, JointErrors]:
    """`Run.default_errors` with the largest networks, as a column; of the first BEST_S of long scenes, as they are slow.

    None where the context has another kind of detector.
    """
    if context.config.detector.name != "blazepose":
        return {}
    shortened = (f"end_s={BEST_S}",) if scene.duration_s > BEST_S else ()
    best = replace(context, overrides=(*context.overrides, f"detector.options.landmarks={BEST_NETWORKS}", *shortened))
    return {"best networks": run_scene(name, scene, best).default_errors()}


def other_bodies(name: str, scene_of: Callable[[int], Scene], context: Context) -> dict[str, dict[str, JointErrors]]:
    """By seed of the bodies that check, columns of errors: of landmarks as they are, of the default, of the best networks."""
    found = {}
    for seed in CHECK_SEEDS:
        done = run_scene(f"{name}-{seed}", scene_of(seed), context)
        best = best_errors(f"{name}-{seed}", scene_of(seed), context)
        found[str(seed)] = {"landmarks": done.errors(centred=False), "default": done.default_errors(), **best}
    return found


def rendered(name: str, scene: Scene, context: Context) -> Path:
    """The session of a scene; rendered where it is not there yet, finished where an earlier run broke off."""
    folder = context.sessions / scene_name(name, scene)
    if not is_rendered(name, scene, context):
        with context.console.stages() as report:
            simulate(scene, folder, partial(report, f"rendering {name}"), context.workers)
    return folder


def is_rendered(name: str, scene: Scene, context: Context) -> bool:
    """Whether the session of a scene is complete."""
    return (context.sessions / scene_name(name, scene) / "truth" / "truth.npz").is_file()


def about(context: Context) -> dict[str, Any]:
    """The machine, the versions and the command of a report."""
    return {
        "machine": f"{processor()}, {usable_cores()} cores",
        "versions": ", ".join(
            [f"posefuse {__version__}", f"Python {platform.python_version()}", *(f"{p} {version(p)}" for p in _PACKAGES)]
        ),
        "command": context.command,
        "settings": ", ".join(context.overrides) or "defaults",
        "length": "quick: seconds of everything" if context.quick else "full",
    }


class Console:
    """Notes and bars on stderr; with `as_json` the figures go to stdout as one object."""

    def __init__(self, as_json: bool) -> None:
        self._as_json = as_json
        self._screen = RichConsole(stderr=True, highlight=False, soft_wrap=True)

    def note(self, text: str) -> None:
        """One line of news."""
        self._screen.print(text, markup=False)

    def figures(self, figures: Mapping[str, Any]) -> None:
        """The one object of a run."""
        if self._as_json:
            print(json.dumps(plain(figures), indent=2), flush=True)

    def stages(self) -> AbstractContextManager[Progress]:
        """What long work reports to."""
        return stage_bars(self._screen, self.note)
