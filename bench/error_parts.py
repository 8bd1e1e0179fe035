"""What the error of joint centres is made of, on rendered people: parts of it are taken out of the 2D, which is solved again.

    PYTHONPATH=. python bench/body_held_out.py --keep DIR --only walk --seeds 7300,7301,...      first: scenes and detections
    PYTHONPATH=. python bench/error_parts.py DIR [--scene walk]

Each view's keypoint (at the joint centre, as the whole-body fit gets it) misses the true joint centre by some pixels. These are
explained, by least squares, by a displacement of the keypoint in the axes of the segment above, in this order:

- ``shared``: a constant of all bodies (from the other bodies);
- ``own``: a constant of this body, left and right for themselves;
- ``pose``: linear in the turn of the segment in the trunk and in the bend of the joint (from the other bodies);
- ``view``: a square of the viewing direction in the segment and in the trunk (from the other bodies);
- ``own view``: the same, of this body alone;
- ``all``: everything. What is left then is what the solve itself adds.

Every row is a solve of 2D without the parts above and its own, so a row is what is left. Use no bodies here that the table of
joint centres was fitted to. A table on stderr, one JSON object on stdout.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from posefuse.core import PoseSequence, Recording, Truth, ViewSequence
from posefuse.core.arrays import Array
from posefuse.core.skeleton import pick_keypoints
from posefuse.evaluation.biomechanics import rays_at_joint_centres
from posefuse.evaluation.metrics import joint_errors, true_xyz_at
from posefuse.formats.recording import read_recording
from posefuse.formats.truth import read_truth
from posefuse.kinematics import SEGMENT_NAMES, segment_axes
from posefuse.kinematics.body import fit_views
from posefuse.pipeline.second_pass import poses_over_time
from posefuse.pipeline.solve import config_of
from posefuse.pipeline.whole_body import usual_length_prior

SIDES = ("left", "right")
# joint -> the segment above, the segment below, the trunk
PARTS_OF = {
    "shoulder": ("thorax", "upper_arm", "thorax"),
    "elbow": ("upper_arm", "forearm", "thorax"),
    "wrist": ("forearm", "forearm", "thorax"),
    "hip": ("pelvis", "thigh", "pelvis"),
    "knee": ("thigh", "shank", "pelvis"),
    "ankle": ("shank", "shank", "pelvis"),
}
ROWS = ("as it is", "shared", "own", "pose", "view", "own view", "all")
# part -> what it is a function of, and whether of this body alone
PARTS = {
    "shared": ("constant", False),
    "own": ("constant", True),
    "pose": ("turn", False),
    "view": ("view", False),
    "own view": ("view", True),
}
LAGS = (1, 5, 10)
# a keypoint farther from the joint centre than this is a confusion; beyond the other errors pull with constant force
MOST_M, HUBER_M = 0.15, 0.02
# of standardised regressors, in measurements
RIDGE = 30.0
STEP_M = 1e-4


@dataclass(frozen=True, eq=False)
class Seen:
    """One kind of joint of one side over all views and time steps.

    Attributes:
        missing_m: (M, 2) from the joint centre to what the view saw, px over px per metre. by_move: (M, 2, 3) what a displacement
            along the (mirrored) axes of the segment does to that. at: (M, 2) time step and camera.
        turn: (M, P) pose; view: (M, V) functions of the viewing direction.
        to_px: (M,) px per metre.
    """

    missing_m: Array
    by_move: Array
    at: Array
    turn: Array
    view: Array
    to_px: Array

    def design(self, regressors: Array) -> Array:
        """(M, 2, 3 F) of regressors (M, F)."""
        return np.asarray(np.einsum("mij,mf->mijf", self.by_move, regressors).reshape(-1, 2, 3 * regressors.shape[1]))


@dataclass(frozen=True, eq=False)
class Body:
    """One recording of one rendered person."""

    recording: Recording
    truth: Truth

    @cached_property
    def rays(self) -> ViewSequence:
        return rays_at_joint_centres(self.recording)

    @cached_property
    def exact(self) -> PoseSequence:
        """The truth at the times of the recording, as poses."""
        poses = self.recording.poses
        xyz = true_xyz_at(self.truth, poses.t_ns)
        shape = xyz.shape[:3]
        cov = np.broadcast_to(np.eye(3) * 1e-8, (*shape, 3, 3))
        return PoseSequence(
            t_ns=poses.t_ns, skeleton=self.truth.skeleton, person_id=poses.person_id, xyz_world=xyz, cov_world=cov,
            reproj_px=np.ones(shape), n_views=np.full(shape, 4), kind=np.ones(shape),
        )  # fmt: skip

    @cached_property
    def axes(self) -> dict[str, Array]:
        """(T, 3, 3) of every segment."""
        found = segment_axes(self.exact).matrix()[:, 0]
        return {name: found[:, i] for i, name in enumerate(SEGMENT_NAMES)}

    def seen(self, side: str, joint: str) -> Seen:
        """What all views saw of one joint, confusions left out."""
        rig, name = self.recording.rig, f"{side}_{joint}"
        mirrored = np.array([1.0, 1.0, -1.0 if side == "left" else 1.0])
        above, below, trunk = (self.axes.get(part, self.axes.get(f"{side}_{part}")) * mirrored for part in PARTS_OF[joint])
        xyz = pick_keypoints(self.exact.xyz_world[:, 0], self.exact.skeleton, (name,))[:, 0]
        k = self.rays.skeleton.index(name)
        turn = np.concatenate([np.einsum("tki,tkj->tij", trunk, above), np.einsum("tki,tkj->tij", above, below)[..., 1:2]], -1)
        turn = turn.reshape(len(turn), 12)
        rows = []
        for c, camera in enumerate(rig):
            at = camera.project(xyz)
            jacobian = np.stack([(camera.project(xyz + STEP_M * e) - at) / STEP_M for e in np.eye(3)], axis=-1)
            to_px = np.linalg.norm(jacobian, axis=(1, 2)) / np.sqrt(2)
            missing = (self.rays.xy_img[:, 0, c, k] - at) / to_px[:, None]
            towards = rig.centres_world()[c] - xyz
            towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
            view = np.concatenate([squares(np.einsum("tji,tj->ti", frame, towards)) for frame in (above, trunk)], axis=-1)
            by_move = jacobian / to_px[:, None, None] @ above
            good = np.isfinite(by_move).all((1, 2)) & np.isfinite(view).all(1) & np.isfinite(turn).all(1)
            good &= (np.linalg.norm(missing, axis=-1) < MOST_M) & (self.rays.score[:, 0, c, k] > 0)
            i = np.flatnonzero(good)
            rows.append((missing[i], by_move[i], np.stack([i, np.full_like(i, c)], -1), turn[i], view[i], to_px[i]))
        return Seen(*(np.concatenate(column) for column in zip(*rows, strict=True)))

    def without(self, moves: dict[str, tuple[Seen, Array]]) -> ViewSequence:
        """The views with parts (M, 2) in metres of what each joint misses taken out."""
        xy = np.array(self.rays.xy_img)
        for name, (seen, metres) in moves.items():
            xy[seen.at[:, 0], 0, seen.at[:, 1], self.rays.skeleton.index(name)] -= metres * seen.to_px[:, None]
        return replace(self.rays, xy_img=xy)

    def solved(self, views: ViewSequence) -> dict[str, PoseSequence]:
        """Fused and smoothed, and by the whole-body fit."""
        config = config_of(self.recording)
        fused = poses_over_time(views, self.recording.rig, config.fuse, config.smooth)
        fitted = fit_views(fused, self.recording.rig, views, config.whole_body, lengths=usual_length_prior()).poses
        return {"fused": fused, "fitted": fitted}


def squares(d: Array) -> Array:
    """(T, 8) functions of unit vectors (T, 3) up to second order, without the constant."""
    x, y, z = d.T
    return np.stack([x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1], axis=-1)


def explained(parts: list[tuple[Array, Array]], ridge: float) -> Array:
    """(F,) of least Huber loss from designs (M, 2, F) and what is to be explained (M, 2)."""
    design, wanted = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    flat, weight = design.reshape(-1, design.shape[-1]), np.ones(len(wanted))
    found = np.zeros(design.shape[-1])
    for _ in range(10):
        w = np.repeat(weight, 2)[:, None]
        found = np.linalg.solve((flat * w).T @ flat + ridge * np.eye(len(found)), (flat * w).T @ wanted.reshape(-1))
        weight = HUBER_M / np.maximum(np.linalg.norm(wanted - design @ found, axis=-1), HUBER_M)
    return found


def moves_of(bodies: list[dict[str, Seen]], joint: str) -> list[list[dict[str, Array]]]:
    """By row and body: side -> metres (M, 2) that all parts up to this row explain of one joint, left and right."""
    scale = {
        kind: np.concatenate([getattr(one[f"{side}_{joint}"], kind) for one in bodies for side in SIDES])
        for kind in ("turn", "view")
    }

    def regressors(seen: Seen, kind: str) -> Array:
        if kind == "constant":
            return np.ones((len(seen.missing_m), 1))
        return np.asarray((getattr(seen, kind) - scale[kind].mean(axis=0)) / (scale[kind].std(axis=0) + 1e-6))

    designs = {
        kind: [
            {side: one[f"{side}_{joint}"].design(regressors(one[f"{side}_{joint}"], kind)) for side in SIDES} for one in bodies
        ]
        for kind in ("constant", "turn", "view")
    }
    total = [{side: np.zeros_like(one[f"{side}_{joint}"].missing_m) for side in SIDES} for one in bodies]
    found = []
    for row in ROWS:
        if row in PARTS:
            kind, alone = PARTS[row]
            design = designs[kind]
            left = [{s: one[f"{s}_{joint}"].missing_m - total[b][s] for s in SIDES} for b, one in enumerate(bodies)]
            for b in range(len(bodies)):
                groups = [(s,) for s in SIDES] if row == "own" else [SIDES]
                for sides in groups:
                    whose = [b] if alone else [other for other in range(len(bodies)) if other != b]
                    metres = explained(
                        [(design[o][s], left[o][s]) for o in whose for s in sides], RIDGE if kind != "constant" else 0.0
                    )
                    total[b] = total[b] | {s: total[b][s] + design[b][s] @ metres for s in sides}
        if row == "all":
            total = [{side: one[f"{side}_{joint}"].missing_m for side in SIDES} for one in bodies]
        found.append(list(total))
    return found


def lasting(errors: list[Array], lag: int) -> float:
    """Share of the variance of errors (T, J, 3) that is the same `lag` time steps later."""
    return float(np.nanmean([np.nanmean(e[lag:] * e[:-lag]) for e in errors]) / np.nanmean([np.nanmean(e**2) for e in errors]))


def measured(bodies: list[Body]) -> dict[str, dict[str, dict[str, float]]]:
    """Row -> fused or fitted -> joint: mean error in mm over bodies and sides; "mean" is that of the paper's 14 joints."""
    names = [f"{side}_{joint}" for side in SIDES for joint in PARTS_OF]
    seen = [{name: body.seen(*name.split("_")) for name in names} for body in bodies]
    moves = {joint: moves_of(seen, joint) for joint in PARTS_OF}
    found: dict[str, dict[str, dict[str, float]]] = {}
    for r, row in enumerate(ROWS):
        errors: dict[str, list[dict[str, float]]] = {"fused": [], "fitted": []}
        series: dict[str, list[Array]] = {"fused": [], "fitted": []}
        for b, body in enumerate(bodies):
            parts = {f"{s}_{joint}": (seen[b][f"{s}_{joint}"], moves[joint][r][b][s]) for joint in PARTS_OF for s in SIDES}
            for way, poses in body.solved(body.without(parts)).items():
                one = joint_errors(poses, body.truth)
                errors[way].append(dict(zip(one.joints, one.mean_mm.tolist(), strict=True)))
                wanted = pick_keypoints(body.exact.xyz_world[:, 0], body.exact.skeleton, names)
                series[way].append(1000 * (pick_keypoints(poses.xyz_world[:, 0], poses.skeleton, names) - wanted))
        found[row] = {
            way: {joint: float(np.mean([one[f"{s}_{joint}"] for one in rows for s in SIDES])) for joint in PARTS_OF}
            | {"mean": float(np.mean([list(one.values()) for one in rows]))}
            | {f"lasts {lag}": lasting(series[way], lag) for lag in LAGS}
            for way, rows in errors.items()
        }
    return found


def show(found: dict[str, dict[str, dict[str, float]]], bodies: int) -> None:
    console = Console(stderr=True, width=150, highlight=False)
    for way in ("fused", "fitted"):
        table = Table(title=f"{bodies} bodies, {way}: mean error in mm without the parts down to each row", title_justify="left")
        for column in ("without", *PARTS_OF, "14 joints", *(f"lasts {lag} steps, %" for lag in LAGS)):
            table.add_column(column)
        for row, ways in found.items():
            figures = [f"{ways[way][joint]:.1f}" for joint in (*PARTS_OF, "mean")]
            table.add_row(row, *figures, *(f"{100 * ways[way][f'lasts {lag}']:.0f}" for lag in LAGS))
        console.print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("keep", type=Path, help="folder of bench/body_held_out.py")
    parser.add_argument("--scene", default="walk")
    arguments = parser.parse_args()
    folders = sorted(arguments.keep.glob(f"*-{arguments.scene}-tracked"))
    bodies = [
        Body(read_recording(folder), read_truth(folder.with_name(folder.name.removesuffix("-tracked")) / "truth" / "truth.npz"))
        for folder in folders
        if (folder / "done").exists()
    ]
    if len(bodies) < 2:
        parser.error(f"{arguments.keep}: two tracked scenes {arguments.scene!r} at least; see --help")
    found = measured(bodies)
    show(found, len(bodies))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
