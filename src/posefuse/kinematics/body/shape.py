"""Segment lengths of one person, solved together with their poses from the rays of many time steps.

Gauss-Newton on lengths and poses at once: the poses of all time steps are independent of each other given the lengths, so each
is solved and eliminated (Schur complement), and the lengths that are left are few. People's proportions are the prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from posefuse.core import PoseSequence, Skeleton
from posefuse.core.arrays import Array, give_away
from posefuse.core.joint_centres import LengthPrior
from posefuse.core.skeleton import SIDES
from posefuse.core.view_sequences import nearest_frames
from posefuse.kinematics.joints import FrameBuffers
from posefuse.kinematics.settings import BodySettings

from . import fit_kernels, tree_kernels
from .filter import Measurement, guessed_state
from .model import FEWEST_SEEN, BodyModel, Length, tree_from_body
from .result import length_derivatives

# the last word of the name of a node's offset -> the segment it is as long as; half of those that lie across the body
_ALONG = {"elbow": "upper_arm", "wrist": "forearm", "knee": "thigh", "ankle": "shank", "neck": "trunk"}
_ACROSS = {"shoulder": "shoulders", "hip": "hips"}
_NAMES = {"hips": ("pelvis",), "shoulders": ("shoulders",), "trunk": ("trunk",)}
_ROUNDS = 10
# a first round's poses may be far from their optimum, and lengths from equations there farther still
_MOST_STEP_M = 0.02
_FIRST_ITERATIONS, _ITERATIONS = 30, 8
_CONVERGED_M = 2e-4
# what else a state would have to be pulled to for its equations to have a solution, in 1 / rad^2
_WEAK = 1e-4
# a state of turns and places, or normal equations
_Pair = tuple[Array, Array]


def with_solved_lengths(
    body: BodyModel, seen: Sequence[Measurement], prior: LengthPrior, settings: BodySettings, workspace: FrameBuffers
) -> BodyModel:
    """The body with lengths estimated from its rays at these time steps and the prior; `BodyModel.lengths` has their sigma.

    The noise is Student-t, and errors of different time steps count as independent. Left and right change by the same. Time steps
    without a pelvis to start from are left out. Medians over time drawn towards the prior (`with_expected_lengths`) give poses as
    good, but hips of rendered people that are 10 % too narrow or wide, not 3.

    Args:
        body: lengths to start from. seen: rays, and points to start poses from, in time order.
    """
    slopes = slopes_of(body, prior.names)
    metres = _metres(body, slopes)
    poses: dict[int, _Pair] = {}
    known = np.linalg.inv(prior.cov_m2)
    information = known
    for round_ in range(_ROUNDS):
        measured, slope = np.zeros_like(known), np.zeros(len(metres))
        tree = tree_from_body(body, settings)
        for i, one in enumerate(seen):
            state = poses.get(i) or guessed_state(body, tree, workspace, one.xyz)
            if state is None:
                continue
            poses[i] = state
            steps = _ITERATIONS if round_ else _FIRST_ITERATIONS
            _add_time_step(tree, slopes, one, settings, state, steps=steps, sums=(measured, slope))
        information = known + measured
        step = np.linalg.solve(information, known @ (prior.mean_m - metres) + slope)
        step *= min(1.0, _MOST_STEP_M / max(float(np.abs(step).max()), 1e-12))
        metres = metres + step
        body = replace(body, offset=body.offset + np.einsum("nsi,s->ni", slopes, step))
        if np.abs(step).max() < _CONVERGED_M:
            break
    cov = np.linalg.inv(information) + settings.offset_sigma_m**2 * np.eye(len(metres))
    solved = _lengths(body, prior.names, metres, np.sqrt(np.diag(cov)))
    return replace(body, lengths=solved, length_slopes=slopes, length_cov=cov)


def with_expected_lengths(body: BodyModel, prior: LengthPrior, sigma_m: float) -> BodyModel:
    """The body with its lengths drawn towards people's, as measurements of this standard deviation or more; no rays are used.

    A length that varied over time counts less: without that a live trial of a half hidden body is off by 92 mm, not 56.
    `BodyModel.lengths` has their sigma.
    """
    slopes = slopes_of(body, prior.names)
    metres = _metres(body, slopes)
    information = np.where(np.isfinite(metres), 1 / (sigma_m**2 + _spreads(body, prior.names) ** 2), 0.0)
    cov = np.linalg.inv(np.linalg.inv(prior.cov_m2) + np.diag(information))
    known = np.isfinite(metres)
    likely = prior.mean_m + cov @ (information * np.where(known, metres - prior.mean_m, 0.0))
    step = np.where(known, likely - metres, 0.0)
    solved = _lengths(body, prior.names, metres + step, np.sqrt(np.diag(cov)))
    offset = body.offset + np.einsum("nsi,s->ni", slopes, step)
    return replace(body, offset=offset, lengths=solved, length_slopes=slopes, length_cov=cov)


def slopes_of(body: BodyModel, names: tuple[str, ...]) -> Array:
    """(nodes, S, 3) by how much each node's offset changes per metre of each segment."""
    slopes = np.zeros((len(body.nodes), len(names), 3))
    for n, node in enumerate(body.nodes):
        end = node.offset.rpartition("_")[2]
        name = _ALONG.get(end) or _ACROSS.get(end)
        if name in names:
            slopes[n, names.index(name)] = body.offset[n] / np.linalg.norm(body.offset[n]) * (0.5 if end in _ACROSS else 1.0)
    return slopes


def _metres(body: BodyModel, slopes: Array) -> Array:
    """(S,) lengths as the body has them, the mean of both sides; NaN for a segment that it does not have."""
    share = np.linalg.norm(slopes, axis=-1)
    offset = np.linalg.norm(body.offset, axis=-1)[:, None]
    has = share > 0
    total = np.where(has, offset / np.where(has, share, 1.0), 0.0).sum(axis=0)
    count = has.sum(axis=0)
    return np.asarray(total / np.where(count > 0, count, np.nan))


def _spreads(body: BodyModel, names: tuple[str, ...]) -> Array:
    """(S,) standard deviations over time of the lengths as they were measured, the larger of both sides; 0 where unknown."""
    keys = ([key for key in _keys(name) if key in body.lengths] for name in names)
    return np.array([max((body.lengths[key].spread_m for key in sides), default=0.0) for sides in keys])


def _keys(name: str) -> tuple[str, ...]:
    """Under which names of `BodyModel.lengths` a segment is."""
    return _NAMES.get(name, (f"left_{name}", f"right_{name}"))


def _add_time_step(
    tree: tree_kernels.Tree, slopes: Array, one: Measurement, settings: BodySettings, state: _Pair, *, steps: int, sums: _Pair
) -> None:
    """Solve the pose of one time step, in place, and add what is left for the lengths to `sums`, their normal equations."""
    q, rot = state
    expected = np.where(tree.slack_var[tree.dof[:-1]] > 0, 0.0, q)
    points, jacobians = np.empty((len(tree.node), 3)), np.empty((len(tree.node), 3, tree.size))
    rays = fit_kernels.SeenKeypoints(one.xyz, np.zeros((len(tree.node), 3, 3)), one.projections, one.xy, one.inverse_var)
    hessian = fit_kernels.gauss_newton(
        tree, (expected, rot.copy()), tree.held(_WEAK), 1.0, rays, settings.robust_dof, 1.0, steps, q, rot
    )  # fmt: skip
    frame, origin = np.empty_like(rot), np.empty((len(rot), 3))
    tree_kernels.keypoints(tree, q, rot, frame, origin, points, jacobians)
    fit_kernels.length_information(
        points, jacobians, length_derivatives(tree, slopes, frame), one.projections, one.xy, one.inverse_var, settings.robust_dof,
        hessian, *sums,
    )  # fmt: skip


def _lengths(body: BodyModel, names: tuple[str, ...], metres: Array, sigma: Array) -> dict[str, Length]:
    lengths = dict(body.lengths)
    for name, value, sd in zip(names, metres.tolist(), sigma.tolist(), strict=True):
        for key in _keys(name):
            if key in lengths:
                lengths[key] = replace(lengths[key], value_m=value, sigma_m=sd)
    return lengths


# A shoulder or hip that never got a 3D point: where it may be, so that the person still has a skeleton to start from.

# a missing joint -> the segment across the body there, and the pair of joints whose line it is taken to be parallel to
_WIDTH_AT = {"shoulder": ("shoulders", "hip"), "hip": ("hips", "shoulder")}


def with_stand_ins(sequence: PoseSequence, prior: LengthPrior) -> PoseSequence:
    """The poses with a shoulder that was hardly ever seen put next to the other one, parallel to the hips, and hips likewise.

    They are as far apart as people's are on average. For the start of a fit alone: nothing was measured there. A person
    who lacks a shoulder and a hip keeps both gaps.
    """
    xyz = sequence.xyz_world.copy()
    places = {name: k for k, name in enumerate(sequence.skeleton.keypoints)}
    for joint, (segment, other) in _WIDTH_AT.items():
        if any(f"{side}_{name}" not in places for side in SIDES for name in (joint, other)) or segment not in prior.names:
            continue
        width_m = float(prior.mean_m[prior.names.index(segment)])
        left, right = (places[f"{side}_{joint}"] for side in SIDES)
        line = sequence.xyz_world[:, :, places[f"right_{other}"]] - sequence.xyz_world[:, :, places[f"left_{other}"]]
        line = width_m * line / np.linalg.norm(line, axis=-1, keepdims=True)
        for n in range(xyz.shape[1]):
            _fill(xyz[:, n], left, right, line[:, n])
    if np.array_equal(xyz, sequence.xyz_world, equal_nan=True):
        return sequence
    give_away(xyz)
    return replace(sequence, xyz_world=xyz)


def _fill(xyz: Array, left: int, right: int, line: Array) -> None:
    """Fill the side of (T, K, 3) that was hardly ever seen from the other, which lies a line (T, 3) to the right or left."""
    seen = {side: np.isfinite(xyz[:, side]).all(axis=-1) for side in (left, right)}
    for missing, known, sign in ((left, right, -1.0), (right, left, 1.0)):
        if seen[missing].sum() < FEWEST_SEEN <= seen[known].sum():
            gaps = ~seen[missing] & seen[known]
            xyz[gaps, missing] = xyz[gaps, known] + sign * line[gaps]


def nearest_in_time(filled: Array, skeleton: Skeleton) -> Array:
    """Fill points (T, N, K, 3) in place: a missing one is where it was nearest in time, carried along by the hips.

    Only a place to start from: a limb that begins bent the wrong way may stay so, since rays far off count little.
    """
    hips = [skeleton.index(f"{side}_hip") for side in SIDES]
    for n in range(filled.shape[1]):
        middle = filled[:, n, hips].mean(axis=1)
        for k in range(filled.shape[2]):
            known = np.flatnonzero(np.isfinite(filled[:, n, k, 0]) & np.isfinite(middle[:, 0]))
            missing = np.flatnonzero(np.isnan(filled[:, n, k, 0]))
            if len(known) and len(missing):
                near = known[nearest_frames(known, missing)]
                filled[missing, n, k] = filled[near, n, k] + middle[missing] - middle[near]
    return filled
