"""The whole-body fit of a finished recording: filter forward, smooth backward."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from posefuse.core import JointAngles, Kind, PoseSequence, Rig, Views, ViewSequence
from posefuse.core.arrays import Array, give_away, take_back
from posefuse.core.skeleton import SIDES
from posefuse.core.view_sequences import PartsOfViews
from posefuse.kinematics.joints import FrameBuffers, frames_of, joints_from_poses, joints_value
from posefuse.kinematics.settings import BodySettings

from .contacts import FOOT, contacts_of, foot_rows
from .filter import BodyFilter, Measurement, of_points, smoothed
from .model import BodyModel, bodies_from_poses
from .result import Fitted, StateReader
from .shape import LengthPrior, nearest_in_time, with_solved_lengths, with_stand_ins

# views of so many time steps are made at once: those of an hour take much memory
_BLOCK_STEPS = 500
# what was seen of the keypoints (A,) of one person at one time step: places on the axes T, N and K
_Measured = Callable[[int, int, Array], Measurement]
_Seen = Callable[[], Iterator[Measurement]]


@dataclass(frozen=True, eq=False)
class BodyFit:
    """A recording explained by one skeleton per person.

    Attributes:
        poses: the keypoints of the fitted skeletons, gaps filled, with their covariance. Points the tree does not carry, and
            time steps before a person could be fitted, are as they were; so is everything of a person without a body.
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
) -> BodyFit:
    """Fit each person's skeleton to 3D points weighted by their covariance.

    Iterated extended Kalman filter on the tree (Gauss-Newton per time step, Student-t noise) and Rauch-Tung-Striebel smoother.

    Raises:
        InputError: a person was never seen well enough to have a skeleton; left and right are swapped.
    """
    settings = settings or BodySettings()
    bodies = bodies if bodies is not None else bodies_from_poses(sequence)

    def measured(i: int, n: int, at: Array) -> Measurement:
        return of_points(int(sequence.t_ns[i]), sequence.xyz_world[i, n, at], sequence.cov_world[i, n, at])

    return _fit(sequence, measured, settings, bodies, FrameBuffers(sequence.skeleton))


def fit_views(
    sequence: PoseSequence,
    rig: Rig,
    views: PartsOfViews,
    settings: BodySettings,
    lengths: LengthPrior,
) -> BodyFit:
    """Fit each person's skeleton directly to the rays of all views: a joint seen by one camera still counts.

    `views` are of the people and times of `sequence`, whose points are where rays start. Segment lengths start as medians over
    time and are then solved together with poses (`with_solved_lengths`, with the prior `lengths`); a shoulder or hip without any
    3D is no obstacle (`with_stand_ins`). Raises as `fit_poses`.

    Poses are written where those of `sequence` lie, which nothing may read any more, and the joints are of no person: of an
    hour, each takes much memory.
    """
    projections, work = rig.projections(), FrameBuffers(sequence.skeleton)
    start = with_stand_ins(sequence, lengths)
    near_world = nearest_in_time(start.xyz_world.copy(), sequence.skeleton)

    def seen_by(view: Views, i: int, n: int, at: Array) -> Measurement:
        xy, inverse_var = _rays_of(rig, view.xy_img[n][:, at], view.score[n][:, at], view.sigma_px[n][:, at])
        xyz, cov = near_world[i, n, at], start.cov_world[i, n, at]
        return Measurement(t_ns=int(sequence.t_ns[i]), xyz=xyz, cov=cov, projections=projections, xy=xy, inverse_var=inverse_var)

    @lru_cache(maxsize=1)
    def views_from(first: int) -> ViewSequence:
        return views.part(slice(first, first + _BLOCK_STEPS))

    steps = np.unique(np.linspace(0, len(sequence) - 1, settings.length_steps).astype(int)).tolist()
    places = {person: n for n, person in enumerate(sequence.person_id.tolist())}
    spread = [(i, views.part(slice(i, i + 1)).at(0)) for i in steps]
    bodies = {
        person: with_solved_lengths(
            body, [seen_by(view, i, places[person], body.keypoint) for i, view in spread], lengths, settings, work
        )
        for person, body in bodies_from_poses(start).items()
    }

    def measured(i: int, n: int, at: Array) -> Measurement:
        place = i % _BLOCK_STEPS
        return seen_by(views_from(i - place).at(place), i, n, at)

    return _fit(sequence, measured, settings, bodies, work, by_rays=True)


def _rays_of(rig: Rig, xy_img: Array, score: Array, sigma_px: Array) -> tuple[Array, Array]:
    """Undistorted pixels (A, C, 2) and 1 / sigma^2 (A, C), 0 where unseen, of views (C, A, ...)."""
    seen = (score > 0) & np.isfinite(xy_img).all(axis=-1) & (sigma_px > 0)
    xy = np.stack([camera.undistort(xy_img[c]) for c, camera in enumerate(rig)])
    seen &= np.isfinite(xy).all(axis=-1)
    inverse_var = np.where(seen, 1.0 / np.where(seen, sigma_px, 1.0) ** 2, 0.0)
    return np.ascontiguousarray(np.swapaxes(np.where(seen[..., None], xy, 0.0), 0, 1)), np.ascontiguousarray(inverse_var.T)


class _Written:
    """The points (T, N, K, 3) of a sequence into which fits are written, and with them the joints if it is not in place."""

    def __init__(self, sequence: PoseSequence, settings: BodySettings, *, in_place: bool) -> None:
        self._sequence, self._most_var = sequence, 3 * settings.most_sigma_m**2
        self._in_place = in_place
        self._planes: list[Array] = []

    def write(self, i: int, n: int, at: Array, fitted: Fitted) -> None:
        """One person at one time step: the keypoints that were seen, and of the others those that are sure."""
        sure = np.trace(fitted.cov, axis1=-2, axis2=-1) < self._most_var
        taken = sure | (self._sequence.kind[i, n, at] != Kind.MISSING)
        xyz, cov, kind, *of_joints = self._written()
        kept = at[taken]
        xyz[i, n, kept] = fitted.xyz[taken]
        cov[i, n, kept] = fitted.cov[taken]
        kind[i, n, kept] = np.where(kind[i, n, kept] == Kind.MISSING, Kind.INTERPOLATED, Kind.SMOOTHED)
        if not self._in_place:
            values = (*frames_of(fitted.rotation, fitted.origin), fitted.angles, fitted.sigmas)
            for plane, value in zip(of_joints, values, strict=True):
                plane[i, n] = value

    def fit(self, bodies: Mapping[int, BodyModel]) -> BodyFit:
        """All that was written."""
        xyz, cov, kind, *of_joints = self._planes or self._before()
        give_away(xyz, cov, kind)
        people = self._sequence.person_id[: of_joints[0].shape[1]]
        return BodyFit(
            replace(self._sequence, xyz_world=xyz, cov_world=cov, kind=kind),
            joints_value(self._sequence.t_ns, people, *of_joints),
            bodies,
        )

    def _written(self) -> list[Array]:
        """Not made before they are asked for: of an hour they take much memory, and so does what shows which feet stand."""
        if not self._planes:
            self._planes = self._before()
            if self._in_place:
                take_back(*self._planes[:3])
            else:
                self._planes = [plane.copy() for plane in self._planes]
        return self._planes

    def _before(self) -> list[Array]:
        poses = self._sequence
        joints = joints_from_poses(poses.people(slice(0)) if self._in_place else poses)
        frames = joints.world_from_segment
        return [poses.xyz_world, poses.cov_world, poses.kind, frames.wxyz, frames.xyz, joints.angle_rad, joints.sigma_rad]


def _fit(
    sequence: PoseSequence,
    measured: _Measured,
    settings: BodySettings,
    bodies: Mapping[int, BodyModel],
    work: FrameBuffers,
    *,
    by_rays: bool = False,
) -> BodyFit:
    """Fit each person, by rays in place; `BodyFit.bodies` are those of people who could be fitted at any time."""
    written, fitted = _Written(sequence, settings, in_place=by_rays), {}
    for n, person in enumerate(sequence.person_id.tolist()):
        if person not in bodies:
            continue
        body, at = bodies[person], bodies[person].keypoint

        def seen(n: int = n, at: Array = at) -> Iterator[Measurement]:
            return (measured(i, n, at) for i in range(len(sequence)))

        stand = by_rays and settings.contact_sigma_m > 0
        filter_ = BodyFilter(body, settings, work)
        reader = StateReader(filter_, work)
        steps = _with_standing_feet(body, seen, sequence.t_ns, settings, work) if stand else seen()
        for i, (one, state) in enumerate(smoothed(filter_, steps)):
            if state is not None:
                written.write(i, n, at, reader.read(state, one))
                fitted[person] = body
    return written.fit(fitted)


def _with_standing_feet(
    body: BodyModel, seen: _Seen, t_ns: Array, settings: BodySettings, work: FrameBuffers
) -> Iterator[Measurement]:
    """What was seen, with the places of feet that stand; a first fit shows which do.

    By the points of the result itself, standing feet slide 15 mm, not 7.
    """
    feet = [row for side in SIDES for row in foot_rows(body.skeleton, body.keypoint, side, FOOT)]
    points, cov = np.full((len(t_ns), len(feet), 3), np.nan), np.full((len(t_ns), len(feet), 3, 3), np.nan)
    filter_ = BodyFilter(body, settings, work)
    reader = StateReader(filter_, work)
    for i, (_, state) in enumerate(smoothed(filter_, seen())):
        if state is not None:
            xyz, spread = reader.points(state)
            points[i], cov[i] = xyz[feet], spread[feet]
    contacts = contacts_of(t_ns, points, cov, body.skeleton, body.keypoint[feet])
    return _standing(seen(), feet, contacts, len(body.keypoint))


def _standing(seen: Iterator[Measurement], feet: list[int], contacts: tuple[Array, Array], count: int) -> Iterator[Measurement]:
    standing, shared = np.full((count, 3), np.nan), np.zeros((count, 3, 3))
    for one, xyz, cov in zip(seen, *contacts, strict=True):
        standing[feet], shared[feet] = xyz, cov
        yield replace(one, standing=standing.copy(), standing_cov=shared.copy())
