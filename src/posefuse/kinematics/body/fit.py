"""The whole-body fit of a finished recording: filter forward, smooth backward."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import JointAngles, Kind, PoseSequence, Rig, Views
from posefuse.core.arrays import Array, give_away
from posefuse.core.view_sequences import PartsOfViews
from posefuse.kinematics.joints import FrameBuffers, frames_of, joints_from_poses, joints_value
from posefuse.kinematics.settings import BodySettings, JointSettings
from posefuse.kinematics.sides import SIDES

from .contacts import FOOT, contacts_of, foot_rows
from .filter import BodyFilter, Measurement, of_points, smoothed
from .model import BodyModel, bodies_from_poses
from .result import StateReader
from .shape import LengthPrior, nearest_in_time, with_solved_lengths, with_stand_ins

# views of so many time steps are made at once: those of an hour take much memory
_BLOCK_STEPS = 500
# what was seen of the keypoints (A,) of one person at one time step: places on the axes T, N and K
_Measured = Callable[[int, int, Array], Measurement]
_Seen = Callable[[], Iterator[Measurement]]

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
    settings, joint_settings = settings or BodySettings(), joint_settings or JointSettings()
    bodies = bodies if bodies is not None else bodies_from_poses(sequence, settings, joint_settings)
    return _fit(sequence, _points_of(sequence), settings, bodies, joint_settings, with_joints=True)


def _points_of(sequence: PoseSequence) -> _Measured:
    def measured(i: int, n: int, at: Array) -> Measurement:
        return of_points(int(sequence.t_ns[i]), sequence.xyz_world[i, n, at], sequence.cov_world[i, n, at])

    return measured


def fit_views(
    sequence: PoseSequence,
    rig: Rig,
    views: PartsOfViews,
    settings: BodySettings | None = None,
    bodies: Mapping[int, BodyModel] | None = None,
    joint_settings: JointSettings | None = None,
    lengths: LengthPrior | None = None,
    *,
    with_joints: bool = True,
) -> BodyFit:
    """Fit each person's skeleton directly to the rays of all views: a joint seen by one camera still counts.

    `views` are of the people and times of `sequence`, to which the bodies are fitted first (`fit_poses`): that is where rays
    start. Segment lengths start as medians over time. With `lengths` as a prior they are then solved together with poses
    (`with_solved_lengths`), and a shoulder or hip without any 3D is no obstacle (`with_stand_ins`). Without `with_joints`,
    those of the fit are of no person: in an hour they take much memory. Raises as `fit_poses`.
    """
    settings, joint_settings = settings or BodySettings(), joint_settings or JointSettings()
    projections = rig.projections()
    start = sequence if lengths is None else with_stand_ins(sequence, lengths)
    if bodies is None:
        bodies = bodies_from_poses(start, settings, joint_settings)
    # keypoints of one body: among fused ones that do not belong together, rays may lead to a pose that explains only a few
    near_world = nearest_in_time(_fit(start, _points_of(start), settings, bodies, joint_settings).poses)

    def seen_by(view: Views, i: int, n: int, at: Array) -> Measurement:
        xy, inverse_var = _rays_of(rig, view.xy_img[n][:, at], view.score[n][:, at], view.sigma_px[n][:, at])
        xyz, cov = near_world[i, n, at], start.cov_world[i, n, at]
        return Measurement(t_ns=int(sequence.t_ns[i]), xyz=xyz, cov=cov, projections=projections, xy=xy, inverse_var=inverse_var)

    blocks = _Blocks(views)

    if lengths is not None:
        work = FrameBuffers(sequence.skeleton, joint_settings)
        steps = np.unique(np.linspace(0, len(sequence) - 1, settings.length_steps).astype(int)).tolist()
        places = {person: n for n, person in enumerate(sequence.person_id.tolist())}
        spread = [(i, views.part(slice(i, i + 1)).at(0)) for i in steps]
        bodies = {
            person: with_solved_lengths(
                body, [seen_by(view, i, places[person], body.keypoint) for i, view in spread], lengths, settings, work
            )
            for person, body in bodies.items()
        }

    def measured(i: int, n: int, at: Array) -> Measurement:
        return seen_by(blocks.at(i), i, n, at)

    return _fit(sequence, measured, settings, bodies, joint_settings, by_rays=True, with_joints=with_joints)


class _Blocks:
    """The views of one time step after the other, made for some hundred time steps at a time."""

    def __init__(self, views: PartsOfViews) -> None:
        self._views = views
        self._first, self._block = 0, views.part(slice(0, _BLOCK_STEPS))

    def at(self, i: int) -> Views:
        """Those of time step `i`."""
        if not self._first <= i < self._first + _BLOCK_STEPS:
            self._first = i - i % _BLOCK_STEPS
            self._block = self._views.part(slice(self._first, self._first + _BLOCK_STEPS))
        return self._block.at(i - self._first)


def _rays_of(rig: Rig, xy_img: Array, score: Array, sigma_px: Array) -> tuple[Array, Array]:
    """Undistorted pixels (A, C, 2) and 1 / sigma^2 (A, C), 0 where unseen, of views (C, A, ...)."""
    seen = (score > 0) & np.isfinite(xy_img).all(axis=-1) & (sigma_px > 0)
    xy = np.stack([camera.undistort(xy_img[c]) for c, camera in enumerate(rig)])
    seen &= np.isfinite(xy).all(axis=-1)
    inverse_var = np.where(seen, 1.0 / np.where(seen, sigma_px, 1.0) ** 2, 0.0)
    return np.ascontiguousarray(np.swapaxes(np.where(seen[..., None], xy, 0.0), 0, 1)), np.ascontiguousarray(inverse_var.T)


def _with_contacts(
    body: BodyModel, seen: _Seen, t_ns: Array, settings: BodySettings, work: FrameBuffers
) -> Iterator[Measurement]:
    """What was seen, with the places of feet that stand; a first fit shows which do."""
    feet = [row for side in SIDES for row in foot_rows(body.skeleton, body.keypoint, side, FOOT)]
    points, cov = np.full((len(t_ns), len(feet), 3), np.nan), np.full((len(t_ns), len(feet), 3, 3), np.nan)
    filter_ = BodyFilter(body, settings, work)
    reader = StateReader(filter_, work)
    for i, (_, state) in enumerate(smoothed(filter_, seen())):
        if state is not None:
            points[i], cov[i] = (values[feet] for values in reader.points(state))
    contacts = contacts_of(t_ns, points, cov, body.skeleton, body.keypoint[feet])
    # a generator keeps its variables to its end
    del points, cov
    standing, shared = np.full((len(body.keypoint), 3), np.nan), np.zeros((len(body.keypoint), 3, 3))
    for i, one in enumerate(seen()):
        standing[feet], shared[feet] = contacts.xyz[i], contacts.cov[i]
        yield replace(one, standing=standing.copy(), standing_cov=shared.copy())


def _fit(
    sequence: PoseSequence,
    measured: _Measured,
    settings: BodySettings,
    bodies: Mapping[int, BodyModel],
    joint_settings: JointSettings,
    *,
    by_rays: bool = False,
    with_joints: bool = False,
) -> BodyFit:
    work = FrameBuffers(sequence.skeleton, joint_settings)

    def before() -> list[Array]:
        joints = joints_from_poses(sequence if with_joints else sequence.people(slice(0)), joint_settings)
        return _planes_of(sequence, joints)

    planes: list[Array] = []
    fitted_bodies = {}
    for n, person in enumerate(sequence.person_id.tolist()):
        if person not in bodies:
            continue
        body = bodies[person]
        at = body.keypoint

        def seen(n: int = n, at: Array = at) -> Iterator[Measurement]:
            return (measured(i, n, at) for i in range(len(sequence)))

        with_feet = by_rays and settings.contact_sigma_m > 0
        filter_ = BodyFilter(body, settings, work)
        reader = StateReader(filter_, work)
        count, far, known = 0, np.zeros(len(at), int), np.zeros(len(at), int)
        steps = _with_contacts(body, seen, sequence.t_ns, settings, work) if with_feet else seen()
        for i, (one, state) in enumerate(smoothed(filter_, steps)):
            # not before: of an hour they take much memory, and so does what shows which feet stand
            planes = planes or [plane.copy() for plane in before()]
            if state is None:
                continue
            xyz, cov, kind, *of_joints = planes
            fitted = reader.read(state, one)
            off = _off(fitted.xyz, sequence.xyz_world[i, n, at], sequence.cov_world[i, n, at])
            count, far, known = count + 1, far + off[0], known + off[1]
            missing = kind[i, n, at] == Kind.MISSING
            sure = np.trace(fitted.cov, axis1=-2, axis2=-1) < 3 * settings.most_sigma_m**2
            kept = at[~missing | sure]
            xyz[i, n, kept], cov[i, n, kept] = fitted.xyz[~missing | sure], fitted.cov[~missing | sure]
            kind[i, n, kept] = np.where(missing, Kind.INTERPOLATED, Kind.SMOOTHED)[~missing | sure]
            if with_joints:
                values = (*frames_of(fitted.rotation, fitted.origin), fitted.angles, fitted.sigmas)
                for plane, value in zip(of_joints, values, strict=True):
                    plane[i, n] = value
        if count and not _failed(count, far, known):
            fitted_bodies[person] = body
        else:
            for plane, unfitted in zip(planes, before(), strict=True):
                plane[:, n : n + 1] = unfitted[:, n : n + 1]
    xyz, cov, kind, *of_joints = planes or before()
    give_away(xyz, cov, kind)
    poses = replace(sequence, xyz_world=xyz, cov_world=cov, kind=kind)
    people = sequence.person_id[: of_joints[0].shape[1]]
    return BodyFit(poses, joints_value(sequence.t_ns, people, *of_joints), fitted_bodies)


def _planes_of(poses: PoseSequence, joints: JointAngles) -> list[Array]:
    frames = joints.world_from_segment
    return [poses.xyz_world, poses.cov_world, poses.kind, frames.wxyz, frames.xyz, joints.angle_rad, joints.sigma_rad]


def _off(fitted: Array, fused: Array, fused_cov: Array) -> tuple[Array, Array]:
    """(..., A) which keypoints (..., A, 3) a fit puts far from the fused ones, and which of these are known."""
    off_m, sigma_m = np.linalg.norm(fitted - fused, axis=-1), np.sqrt(np.trace(fused_cov, axis1=-2, axis2=-1))
    return off_m > np.maximum(_FAILED_M, _FAILED_SIGMAS * sigma_m), np.isfinite(off_m) & np.isfinite(sigma_m)


def _failed(count: int, far: Array, known: Array) -> bool:
    """Whether a fit of `count` time steps found another pose than was seen: in how many each keypoint (A,) is far, and known."""
    return bool((far > _FAILED_SHARE * np.maximum(known, count / 2)).any())
