"""A learned residual next to the whole-body fit: does it help rendered walks, and does it leave real footage as good as it was?

    python bench/view_residual.py render OUT               draw walks and other motions; cameras, lenses, light, images vary
    python bench/view_residual.py judge OUT [MORE ...] --keep DIR [--real SESSION]

What a network misses of a joint centre in one view (see `bench/error_parts.py`) is learned by ridge regression on functions of
the fused pose (turn of the segment in the trunk, bend of the joint) and of the viewing direction in segment and trunk, as a
displacement in the axes of the segment: at most 29 x 3 numbers a joint. It is subtracted from the keypoints of every view, which
are then fused and fitted again. Learned on the scenes of OUT and MORE (folders of the `render` of `fit_joint_centres.py` and of
`fit_blazepose_noise.py`; bodies of random seeds 7000 to 7429), judged on the walks of DIR (`bench/body_held_out.py --keep DIR
--only walk --seeds 7300,...`) and on the real recording of `bench/real_footage.py`, by the distance to the other pipeline's
result and by how well the views agree. Tracked scenes are kept in OUT. A table on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from error_parts import PARTS_OF, SIDES, Body, Seen, explained
from real_footage import LIMBS, REFERENCE, distances_mm, keypoint
from rich.console import Console
from rich.table import Table

from posefuse.core import PoseSequence, Recording, Truth
from posefuse.core.arrays import Array
from posefuse.evaluation.fitting.scenes import FLOORS, RATE_HZ, is_rendered
from posefuse.evaluation.metrics import joint_errors
from posefuse.formats.joint_centres import joint_centres_from_mapping
from posefuse.formats.recording import read_recording, write_recording
from posefuse.formats.trc import read_trc
from posefuse.formats.truth import read_truth
from posefuse.foundation.settings import settings_from_mapping
from posefuse.kinematics import SEGMENT_NAMES, segment_axes
from posefuse.pipeline.clock import StageClock
from posefuse.pipeline.config import CameraInput, TrackConfig
from posefuse.pipeline.run import track_session
from posefuse.pipeline.second_pass import poses_over_time
from posefuse.pipeline.session import find_session
from posefuse.pipeline.solve import config_of
from posefuse.simulation.scene import Scene
from posefuse.simulation.session import simulate

SCENES, FIRST_BODY = 30, 7400
FORMS = ("nothing", "constant", "view", "pose and view", "half of it")
RIDGE = 100.0
NAMES = tuple(f"{side}_{joint}" for side in SIDES for joint in PARTS_OF)


class Tracked(Body):
    """A recording seen with what the pipeline knows of the pose, not with the truth."""

    @cached_property
    def axes(self) -> dict[str, Array]:
        found = segment_axes(self.recording.poses).matrix()[:, 0]
        return {name: found[:, i] for i, name in enumerate(SEGMENT_NAMES)}


def varied_scene(i: int) -> dict[str, Any]:
    """A walk (two of three scenes) or another motion, before cameras, in light and in images of its own."""
    rng = np.random.default_rng(94_000 + i)
    turn = rng.uniform(0, 360)
    cameras = []
    for c in range(4):
        angle, radius_m = np.radians(turn + 90 * c + rng.uniform(-25, 25)), rng.uniform(3.2, 5.8)
        cameras.append(
            {
                "name": f"cam{c:02d}",
                "position_m": [radius_m * np.cos(angle), radius_m * np.sin(angle), rng.uniform(0.9, 2.9)],
                "look_at_m": [*rng.uniform(-0.2, 0.2, 2), rng.uniform(0.8, 1.1)],
                "roll_deg": rng.uniform(-7, 7),
                "image": {
                    "size_px": [640, 480],
                    "horizontal_fov_deg": rng.uniform(58, 85),
                    "distortion": [rng.uniform(-0.2, 0.05), 0, 0, 0],
                },
                "sensor": {"noise_dn": rng.uniform(0, 5)},
            }
        )
    paths = (
        {"shape": "random", "low_m": [-1.6, -1.6], "high_m": [1.6, 1.6]},
        {"shape": "circle", "radius_m": rng.uniform(1.15, 1.5), "clockwise": bool(i % 2)},
        {"shape": "back_forth", "start_m": [-1.4, -0.8], "end_m": [1.3, 0.9]},
    )
    walk = {"kind": "walk", "speed_mps": rng.uniform(0.7, 1.6), "path": paths[i % 3]}
    others = (
        {"kind": "turn", "period_s": 4.6},
        {"kind": "sit", "period_s": 3.6},
        {"kind": "overhead", "period_s": 2.2},
        {"kind": "reach", "side": SIDES[i % 2], "period_s": 1.7},
    )
    return {
        "duration_s": 8.0,
        "rate_hz": RATE_HZ,
        "seed": 800 + i,
        "cameras": {"kind": "list", "cameras": cameras},
        "people": [{"body": {"random_seed": FIRST_BODY + i}, "motion": others[i // 3 % 4] if i % 3 == 2 else walk}],
        "room": {
            "floor": FLOORS[int(rng.integers(4))],
            "walls": ("office", "plain", "none")[int(rng.integers(3))],
            "brightness": rng.uniform(0.45, 1.5),
            "shadows": bool(rng.integers(2)),
        },
        "record": {"kind": "jpeg", "quality": int(rng.integers(55, 96))},
    }


def render(out: Path) -> None:
    """Minutes; resumes."""
    for i in range(SCENES):
        folder = out / f"scene{i:02d}"
        if not is_rendered(folder):
            simulate(settings_from_mapping(varied_scene(i), Scene, where=folder.name), folder, processes=1)
            print(f"{folder.name}: rendered", flush=True)


def recorded(session: Path, kept: Path, config: TrackConfig) -> Recording:
    """A session tracked with the default network, from the folder `kept` if it is there."""
    if not (kept / "done").exists():

        def silent(*_: object) -> None: ...

        recording = track_session(find_session(session, config), config, StageClock(), silent, silent, silent).recording
        kept.mkdir(parents=True, exist_ok=True)
        write_recording(kept, recording)
        (kept / "done").touch()
    return read_recording(kept)


def learned_from(folders: Sequence[Path]) -> list[dict[str, Seen]]:
    """What all views saw of all joints of everybody."""
    found = []
    for folder in folders:
        for session in (one for one in sorted(folder.glob("scene*")) if is_rendered(one)):
            truth = read_truth(session / "truth" / "truth.npz")
            inputs = {name: CameraInput(images=f"videos/{name}") for name in truth.rig.names}
            config = TrackConfig(rate_hz=RATE_HZ, cameras=inputs, outputs={})
            recording = unsmoothed(recorded(session, folders[0] / "tracked" / f"{folder.name}-{session.name}", config))
            if len(recording.poses.person_id) == 1:
                body = Tracked(recording, truth)
                found.append({name: body.seen(*name.split("_")) for name in NAMES})
    return found


def unsmoothed(recording: Recording) -> Recording:
    """The scenes have too few time steps per second to be smoothed."""
    table = joint_centres_from_mapping(recording.provenance["joint_centres"], "provenance")
    return replace(recording, poses=poses_over_time(recording.views, recording.rig, config_of(recording).fuse, None, table))


class Residual:
    """What is learned of one joint: metres in the axes of the segment, linear in standardised functions of pose and view."""

    def __init__(self, form: str, joint: str, everybody: Sequence[dict[str, Seen]]) -> None:
        self._form = form
        seen = [one[f"{side}_{joint}"] for one in everybody for side in SIDES]
        functions = np.concatenate([self._functions(one) for one in seen])
        self._mean, self._sd = functions.mean(axis=0), functions.std(axis=0) + 1e-3
        self._metres = explained([(one.design(self._standardised(one)), one.missing_m) for one in seen], RIDGE)

    def _functions(self, seen: Seen) -> Array:
        parts = [seen.turn] * ("pose" in self._form or self._form == "half of it")
        parts += [seen.view] * ("view" in self._form or self._form == "half of it")
        return np.concatenate(parts, axis=-1) if parts else np.zeros((len(seen.missing_m), 0))

    def _standardised(self, seen: Seen) -> Array:
        scaled = (self._functions(seen) - self._mean) / self._sd
        return np.concatenate([np.ones((len(scaled), 1)), scaled], axis=-1)

    def of(self, seen: Seen) -> Array:
        """(M, 2) metres."""
        return np.asarray(seen.design(self._standardised(seen)) @ self._metres) * (0.5 if self._form == "half of it" else 1.0)


def solved(body: Body, form: str, residuals: dict[str, Residual]) -> dict[str, PoseSequence]:
    """Fused and fitted, with the residual taken out of every view."""
    moves = {}
    for name in NAMES if form != "nothing" else ():
        seen = body.seen(*name.split("_"))
        moves[name] = (seen, residuals[name.partition("_")[2]].of(seen))
    return body.solved(body.without(moves))


def real_body(session: Path, kept: Path) -> tuple[Tracked, Array]:
    """The real recording, its own result in place of a truth, and the reference (T, 12, 3)."""
    recording = recorded(session, kept, TrackConfig(outputs={}))
    poses, reference = recording.poses, read_trc(session / REFERENCE)
    stand_in = Truth(
        rig=recording.rig, t_ns=poses.t_ns, skeleton=poses.skeleton, person_id=poses.person_id, xyz_world=poses.xyz_world,
        views=tuple(no_view(name, len(poses.person_id), len(poses.skeleton)) for name in recording.rig.names),
    )  # fmt: skip
    every = [keypoint(name) for name in reference.names]
    return Tracked(recording, stand_in), reference.xyz_world[:, [every.index(name) for name in LIMBS]]


def no_view(name: str, people: int, keypoints: int) -> Any:
    """A camera's truth of no frames."""
    from posefuse.core.truth import CameraTruth

    nothing = np.zeros((0, people, keypoints))
    return CameraTruth(camera=name, t_ns=np.zeros(0), xy_img=np.stack([nothing, nothing], axis=-1), visible=nothing)


def judged(
    learned: list[dict[str, Seen]], walks: list[Tracked], real: tuple[Tracked, Array] | None
) -> dict[str, dict[str, float]]:
    """By form: mean error of rendered walks, mean of medians of the real recording, and px by which its views disagree."""
    found: dict[str, dict[str, float]] = {}
    for form in FORMS:
        residuals = {} if form == "nothing" else {joint: Residual(form, joint, learned) for joint in PARTS_OF}
        errors = [
            {way: joint_errors(poses, body.truth).mpjpe_mm for way, poses in solved(body, form, residuals).items()}
            for body in walks
        ]
        row = {f"walk {way} mm": float(np.mean([one[way] for one in errors])) for way in ("fused", "fitted")}
        if real is not None:
            body, reference = real
            poses = solved(body, form, residuals)
            for way, one in poses.items():
                row[f"real {way} mm"] = float(np.nanmedian(distances_mm(one, LIMBS, reference), axis=0).mean())
            limbs = poses["fused"].skeleton.indices(LIMBS)
            row["real views disagree px"] = float(np.nanmedian(poses["fused"].reproj_px[:, 0, limbs]))
        found[form] = row
        print(form, row, file=sys.stderr, flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("render", "judge"))
    parser.add_argument("out", type=Path)
    parser.add_argument("more", type=Path, nargs="*")
    parser.add_argument("--keep", type=Path, help="folder of bench/body_held_out.py")
    parser.add_argument("--real", type=Path, default=Path("../shared/data/pose2sim_single"))
    arguments = parser.parse_args()
    if arguments.step == "render":
        render(arguments.out)
        return
    if arguments.keep is None:
        parser.error("--keep DIR is required: walks to judge on")
    learned = learned_from([arguments.out, *arguments.more])
    walks = [
        Tracked(read_recording(path), read_truth(path.with_name(path.name.removesuffix("-tracked")) / "truth" / "truth.npz"))
        for path in sorted(arguments.keep.glob("*-walk-tracked"))
    ]
    real = real_body(arguments.real, arguments.out / "tracked" / "real") if (arguments.real / REFERENCE).is_file() else None
    found = judged(learned, walks, real)
    table = Table(
        title=f"learned on {len(learned)} rendered scenes, judged on {len(walks)} walks of others", title_justify="left"
    )
    for column in ("taken out of the views", *found["nothing"]):
        table.add_column(column)
    for form, row in found.items():
        table.add_row(form, *(f"{value:.2f}" for value in row.values()))
    Console(stderr=True, width=150, highlight=False).print(table)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
