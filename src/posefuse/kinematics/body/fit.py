"""The whole-body fit of a finished recording: filter forward, smooth backward."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import JointAngles, Kind, PoseSequence, Rig, ViewSequence
from posefuse.core.arrays import Array
from posefuse.kinematics.joints import FrameBuffers, joints_from_poses, joints_value
from posefuse.kinematics.settings import JointSettings

from .contacts import contacts_of
from .filter import BodyFilter, Measurement, State, smoothed
from .model import BodyModel, bodies_from_poses
from .result import StateReader
from .settings import BodySettings
from .shape import LengthPrior, with_solved_lengths
from .stand_in import nearest_in_time, with_stand_ins
from .tracker import rays_of

# a fit has failed when a keypoint is farther from the fused one than this and than so many of its standard deviations for this
# share of the time; fits that found the right limb while fusion was misled by a false one stay below a quarter
_FAILED_M, _FAILED_SIGMAS, _FAILED_SHARE = 0.1, 3.0, 1 / 3


@dataclass(frozen=True, eq=False)
class BodyFit:
    """A recording explained by one skeleton per person.

    Attributes:
        poses: the keypoints of the fitted skeletons, gaps filled, with their covariance. Points the tree does not carry, and
            time steps before a person could be fitted, are as they were; so is everything of a person without a body or whose
            fit failed: for a third of the time, a keypoint was far from where the fused one is.
        joints: angles and frames with the uncertainty of the fit.
        bodies: each fitted person's skeleton, by person_id; `BodyModel.lengths` has the segment lengths with their spread.
    """

    poses: PoseSequence
    joints: JointAngles
    bodies: Mapping[int, BodyModel]


def fit_poses(
    sequence: PoseSequence,
    settings: BodySettings | None = None,
    bodies: Mapping[int, BodyModel] | None = None,
    joint_settings: JointSettings | None = None,
) -> BodyFit:
    """Fit each person's skeleton to 3D points weighted by their covariance.

    Iterated extended Kalman filter on the tree (Gauss-Newton per time step, Student-t noise) and Rauch-Tung-Striebel smoother.

    Raises:
        InputError: a person was never seen well enough to have a skeleton; left and right are swapped.
    """
    none = np.zeros((0, 3, 4))

    def measured(i: int, n: int, at: Array) -> Measurement:
        empty = np.zeros((len(at), 0))
        xyz, cov = sequence.xyz_world[i, n, at], sequence.cov_world[i, n, at]
        return Measurement(
            t_ns=int(sequence.t_ns[i]), xyz=xyz, cov=cov, projections=none, xy=empty[..., None] + [0, 0], inverse_var=empty
        )

    return _fit(sequence, measured, settings, bodies, joint_settings)


def fit_views(
    sequence: PoseSequence,
    rig: Rig,
    views: ViewSequence,
    settings: BodySettings | None = None,
    bodies: Mapping[int, BodyModel] | None = None,
    joint_settings: JointSettings | None = None,
    lengths: LengthPrior | None = None,
) -> BodyFit:
    """Fit each person's skeleton directly to the rays of all views: a joint seen by one camera still counts.

    `views` are of the people and times of `sequence`, to which the bodies are fitted first (`fit_poses`): that is where rays
    start. Segment lengths start as medians over time. With `lengths` as a prior they are then solved together with poses
    (`with_solved_lengths`), and a shoulder or hip without any 3D is no obstacle (`with_stand_ins`). Raises as `fit_poses`.
    """
    settings = settings or BodySettings()
    projections = rig.projections()
    start = sequence if lengths is None else with_stand_ins(sequence, lengths)
    if bodies is None:
        bodies = bodies_from_poses(start, settings, joint_settings)
    # keypoints of one body: among fused ones that do not belong together, rays may lead to a pose that explains only a few
    near_world = nearest_in_time(fit_poses(start, settings, bodies, joint_settings).poses)

    def measured(i: int, n: int, at: Array) -> Measurement:
        xy, inverse_var = rays_of(
            rig,
            views.xy_img[i, n][:, at],
            views.score[i, n][:, at],
            views.sigma_px[i, n][:, at],
        )
        xyz, cov = near_world[i, n, at], start.cov_world[i, n, at]
        return Measurement(t_ns=int(sequence.t_ns[i]), xyz=xyz, cov=cov, projections=projections, xy=xy, inverse_var=inverse_var)

    if lengths is not None:
        work = FrameBuffers(sequence.skeleton, joint_settings or JointSettings())
        steps = np.unique(np.linspace(0, len(sequence) - 1, settings.length_steps).astype(int)).tolist()
        places = {person: n for n, person in enumerate(sequence.person_id.tolist())}
        bodies = {
            person: with_solved_lengths(
                body, [measured(i, places[person], body.keypoint) for i in steps], lengths, settings, work
            )
            for person, body in bodies.items()
        }
    return _fit(sequence, measured, settings, bodies, joint_settings)


def _states(
    body: BodyModel, seen: list[Measurement], settings: BodySettings, work: FrameBuffers
) -> tuple[BodyFilter, list[State | None], list[Measurement]]:
    """Smoothed states of one person, fitted to rays twice: the first fit shows which feet stand where."""
    filter_ = BodyFilter(body, settings, work)
    states = smoothed(filter_, [filter_.step(one) for one in seen])
    if not settings.contact_sigma_m or not len(seen[0].projections):
        return filter_, states, seen
    reader, count = StateReader(filter_, work), len(body.keypoint)
    points, cov = np.full((len(seen), count, 3), np.nan), np.full((len(seen), count, 3, 3), np.nan)
    for i, state in enumerate(states):
        if state is not None:
            points[i], cov[i] = reader.points(state)
    contacts = contacts_of(np.array([one.t_ns for one in seen]), points, cov, body.skeleton, body.keypoint)
    standing = zip(seen, contacts.xyz, contacts.cov, strict=True)
    seen = [replace(one, standing=xyz, standing_cov=shared) for one, xyz, shared in standing]
    filter_ = BodyFilter(body, settings, work)
    return filter_, smoothed(filter_, [filter_.step(one) for one in seen]), seen


def _fit(
    sequence: PoseSequence,
    measured: Callable[[int, int, Array], Measurement],
    settings: BodySettings | None,
    bodies: Mapping[int, BodyModel] | None,
    joint_settings: JointSettings | None,
) -> BodyFit:
    """`measured` gives what was seen of the keypoints (A,) of one person at one time step."""
    settings, joint_settings = settings or BodySettings(), joint_settings or JointSettings()
    bodies = bodies if bodies is not None else bodies_from_poses(sequence, settings, joint_settings)
    work = FrameBuffers(sequence.skeleton, joint_settings)
    xyz, cov, kind = sequence.xyz_world.copy(), sequence.cov_world.copy(), sequence.kind.copy()
    plain = joints_from_poses(sequence, joint_settings)
    rotation, origin = plain.world_from_segment.matrix().copy(), plain.world_from_segment.xyz.copy()
    angles, sigmas = plain.angle_rad.copy(), plain.sigma_rad.copy()
    fitted_bodies = {}
    for n, person in enumerate(sequence.person_id.tolist()):
        if person not in bodies:
            continue
        at = bodies[person].keypoint
        seen = [measured(i, n, at) for i in range(len(sequence))]
        filter_, states, seen = _states(bodies[person], seen, settings, work)
        reader = StateReader(filter_, work)
        read = {i: reader.read(state, seen[i]) for i, state in enumerate(states) if state is not None}
        steps = list(read)
        if not read or _failed(np.array([one.xyz for one in read.values()]), xyz[steps, n][:, at], cov[steps, n][:, at]):
            continue
        fitted_bodies[person] = bodies[person]
        for i, fitted in read.items():
            missing = kind[i, n, at] == Kind.MISSING
            sure = np.trace(fitted.cov, axis1=-2, axis2=-1) < 3 * settings.most_sigma_m**2
            kept = at[~missing | sure]
            xyz[i, n, kept], cov[i, n, kept] = fitted.xyz[~missing | sure], fitted.cov[~missing | sure]
            kind[i, n, kept] = np.where(missing, Kind.INTERPOLATED, Kind.SMOOTHED)[~missing | sure]
            rotation[i, n], origin[i, n], angles[i, n], sigmas[i, n] = (
                fitted.rotation,
                fitted.origin,
                fitted.angles,
                fitted.sigmas,
            )
    poses = replace(sequence, xyz_world=xyz, cov_world=cov, kind=kind)
    return BodyFit(poses, joints_value(sequence.t_ns, sequence.person_id, rotation, origin, angles, sigmas), fitted_bodies)


def _failed(fitted: Array, fused: Array, fused_cov: Array) -> bool:
    """Whether a fit (T, A, 3) found another pose than the one that was seen: by fused keypoints (T, A, 3), (T, A, 3, 3)."""
    off_m, sigma_m = np.linalg.norm(fitted - fused, axis=-1), np.sqrt(np.trace(fused_cov, axis1=-2, axis2=-1))
    far = off_m > np.maximum(_FAILED_M, _FAILED_SIGMAS * sigma_m)
    known = np.isfinite(off_m) & np.isfinite(sigma_m)
    return bool((far.sum(axis=0) > _FAILED_SHARE * np.maximum(known.sum(axis=0), len(off_m) / 2)).any())
