"""Bodies rendered one at a time for several benches: scenes, what the networks saw in them, and how the live tracker follows."""

from __future__ import annotations

import json
import secrets
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from harness import JOINTS, Use, covariances, errors, played, rendered, scene_from, score, tracked, truth_of

from paper.scenes.scenes import half_hidden_scene, ring, static_scene, walking_scene
from posefuse.core import Detections2D, JointCentres, LiveJointCentres, Pose3D, Recording, Truth
from posefuse.core.skeleton import SIDES
from posefuse.formats.joint_centres import joint_centres_from_mapping
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.tracking.online import MOTION, LiveMotion
from posefuse_sim.scene import Scene

_HIDDEN_S, _HIDDEN_HZ = 3.0, 10.0
# of live trials
RATE_HZ, SECONDS, OUTPUT_HZ, WARM_UP_S = 30.0, 4.0, 100.0, 1.0
ARRIVE: Mapping[str, tuple[float, float]] = {"late": (0.02, 0.06), "at once": (0.0, 0.001)}
# of a live trial, by default
MOVES = ("idle", "walk", "reach", "squat", "turn", "screen", "false_arm")
# fits and the reported experiments draw bodies of smaller seeds
_SMALLEST_SEED, _SEEDS = 100_000, 900_000


# in two of them half of the body is hidden
HIDDEN = ("screen", "false_arm")
SCENES = ("walk", "T-pose", "T-pose-occluded", *HIDDEN, "squat", "reach", "wave", "overhead", "sit", "turn")


def scene_of(name: str, seed: int) -> Scene:
    """One body doing one thing; the rest of the scene is drawn by the same seed."""
    if name in HIDDEN:
        scene = half_hidden_scene(name, _HIDDEN_S, _HIDDEN_HZ)
        person = replace(scene.people[0], body=replace(scene.people[0].body, random_seed=seed))
        return replace(scene, people=(person,), seed=seed)
    if name.startswith("T-pose"):
        return static_scene(name.endswith("occluded"), seed, 0.5)
    if name == "walk":
        return replace(walking_scene(seed, 10.0), rate_hz=10.0)
    person = {"body": {"random_seed": seed}, "motion": _motion(name, seed)}
    content = {"duration_s": 3.0, "rate_hz": 10, "seed": seed, "cameras": ring(4, 66.0), "people": [person]}
    return scene_from(content, Use.DEVELOP)


def _motion(name: str, seed: int) -> dict[str, Any]:
    """Where a person faces, with which arm, and how fast, differ from body to body."""
    rng = np.random.default_rng([seed, 5])
    heading, side, pace = float(rng.uniform(0, 360)), SIDES[int(rng.integers(2))], float(rng.uniform(0.85, 1.15))
    if name == "idle":
        return {"kind": "idle", "heading_deg": heading}
    period_s = {"squat": 2.7, "reach": 1.5, "wave": 0.9, "overhead": 2.6, "sit": 3.0, "turn": 4.0}[name] * pace
    one_arm = {"side": side} if name in ("reach", "wave") else {}
    return {"kind": name, "heading_deg": heading, "period_s": period_s, **one_arm}


def seeds_of(keep: Path, count: int, given: str) -> list[int]:
    """Seeds as given, or those kept in the folder; drawn now if there are none."""
    if given:
        return [int(seed) for seed in given.split(",")]
    keep.mkdir(parents=True, exist_ok=True)
    file = keep / "seeds.json"
    seeds: list[int] = json.loads(file.read_text()) if file.exists() else []
    while len(seeds) < count:
        seeds.append(_SMALLEST_SEED + secrets.randbelow(_SEEDS))
    file.write_text(json.dumps(seeds))
    return seeds[:count]


def views_of(recording: Recording) -> list[Detections2D]:
    """The first look at every frame, in the order of exposure."""
    seen, found = recording.observations, dict[tuple[int, str], Detections2D]()
    for frame in np.flatnonzero(seen.n_detections):
        one = seen.detections(frame)
        found.setdefault((one.t_ns, one.camera), one)
    return [found[key] for key in sorted(found)]


def table_of(recording: Recording) -> JointCentres:
    """From the network's keypoints to joint centres."""
    return joint_centres_from_mapping(recording.provenance["joint_centres"], "provenance: joint_centres")


@dataclass(frozen=True)
class Trial:
    """One scene, with its views in the order in which they arrive."""

    recording: Recording
    truth: Truth
    arrivals: list[tuple[int, Detections2D]]

    @staticmethod
    def of(session: Path, arrive: str, seed: int) -> Trial:
        """Of a rendered session; arrive: one of `ARRIVE`."""
        recording = tracked(session, body="off")
        views = views_of(recording)
        late_ns = 1e9 * np.random.default_rng(seed).uniform(*ARRIVE[arrive], len(views))
        come = [(round(view.t_ns + late), view) for view, late in zip(views, late_ns, strict=True)]
        return Trial(recording, truth_of(session), sorted(come, key=lambda one: one[0]))

    def poses(self, config: LiveConfig, motion: LiveMotion = MOTION) -> Iterator[Pose3D]:
        """At joint centres, at 100 Hz, after the warm-up."""
        rig, skeleton = self.recording.rig, self.recording.observations.skeleton
        estimator = warmed_up(rig, skeleton, config, motion=motion)
        estimator.centring.learn(LiveJointCentres(t_ns=0, cameras=rig.names, table=table_of(self.recording)))
        first_ns = int(self.truth.t_ns[0])
        ticks = np.arange(first_ns, int(self.truth.t_ns[-1]), round(1e9 / OUTPUT_HZ)).tolist()
        for landmarks in played(estimator.tracker, self.arrivals, ticks):
            pose = estimator.placed(landmarks)
            if pose.t_ns >= first_ns + WARM_UP_S * 1e9 and len(pose.person_id):
                yield pose

    def accuracy(self, motion: LiveMotion = MOTION) -> dict[str, float]:
        """`harness.score` of the joints at output time."""
        poses = list(self.poses(LiveConfig(), motion))
        return score(errors(poses, self.truth, JOINTS), covariances(poses, JOINTS))


def trial_session(keep: Path, row: str, seed: int, use: Use) -> Path:
    """A scene of live trials, rendered in the folder."""
    return rendered(replace(scene_of(row, seed), rate_hz=RATE_HZ, duration_s=SECONDS), keep / f"{seed}-{row}", use)
