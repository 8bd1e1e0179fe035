"""One person's skeleton while the person is followed live: lengths learnt on the way, and a pose at every output tick.

Every few output ticks the pose is fitted to rays. Between two such fits it follows the tracked keypoints, each moved by what the
fits found it off by. It is always a pose of the skeleton, so its segments keep their lengths. Only where a fit begins or ends,
the output passes from one pose to the other over a short time, in which they do not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import Skeleton
from posefuse.core.arrays import Array
from posefuse.kinematics.joints import FrameBuffers
from posefuse.kinematics.settings import BodySettings, LiveBodyRules

from . import fit_kernels, tree_kernels
from .contacts import StandingFeet
from .filter import guessed_state, information_of
from .model import BodyModel, body_from_frames, tree_from_body
from .result import squared_misses, variance_factor
from .shape import LengthPrior, with_expected_lengths

# when there are more, every other one is left out
_MOST_SAMPLES = 64
_LEAST_SHARE = 0.5


class LearntBody:
    """One person's skeleton, learnt from tracked keypoints at joint centres.

    Attributes:
        body: as it is now; None until enough was seen. Its lengths change by no more than `length_rate_m_s`.
    """

    def __init__(
        self, skeleton: Skeleton, settings: BodySettings, live: LiveBodyRules, prior: LengthPrior, work: FrameBuffers
    ) -> None:
        self.body: BodyModel | None = None
        self._way: _Way | None = None
        self._skeleton, self._settings, self._live, self._prior, self._work = skeleton, settings, live, prior, work
        self._every_ns = round(live.sample_every_s * 1e9)
        self._samples: list[tuple[int, Array, Array, Array]] = []
        self._seen_s, self._due_s = 0.0, live.learn_s
        self._t_ns = 0

    def step(self, t_ns: int, xyz: Array, cov: Array, measured: Array) -> bool:
        """Take the next pose (K, ...) in; whether the skeleton changed."""
        elapsed_s, self._t_ns = (t_ns - self._t_ns) * 1e-9, t_ns
        if self._due_s <= self._live.learn_most_s and self._sampled(t_ns, xyz, cov, measured) and self._seen_s >= self._due_s:
            self._due_s *= 2
            self._learn()
        before = self.body
        if self._way is not None and before is not self._way.end:
            self.body = self._way.after(self._live.length_rate_m_s * elapsed_s)
        return self.body is not before

    def _sampled(self, t_ns: int, xyz: Array, cov: Array, measured: Array) -> bool:
        if self._samples and t_ns - self._samples[-1][0] < self._every_ns:
            return False
        good = measured & (np.trace(cov, axis1=-2, axis2=-1) / 3 < self._live.sure_m**2)
        if good.mean() < _LEAST_SHARE:
            return False
        known = np.where(good[:, None], xyz, np.nan)
        self._samples.append((t_ns, known, np.where(good[:, None, None], cov, np.nan), self._work.frames_alone(known)))
        self._seen_s += self._every_ns * 1e-9
        if len(self._samples) > _MOST_SAMPLES:
            del self._samples[::2]
            self._every_ns *= 2
        return True

    def _learn(self) -> None:
        _, xyz, cov, frames = (np.array(column) for column in zip(*self._samples, strict=True))
        body = body_from_frames(self._skeleton, xyz, cov, frames)
        if body is not None:
            self._way = _Way(self.body, with_expected_lengths(body, self._prior, self._live.length_sigma_m))


class _Way:
    """From one skeleton to another in small steps; at once to one of another tree, or where there is none yet.

    Attributes:
        end: where it leads.
    """

    def __init__(self, start: BodyModel | None, end: BodyModel) -> None:
        self.end = end
        self._whole_m = self._left_m = 0.0
        if start is not None and start.same_tree(end):
            self._offset, self._local = end.offset - start.offset, end.keypoint_local - start.keypoint_local
            self._whole_m = max(float(np.linalg.norm(change, axis=1).max()) for change in (self._offset, self._local))
            self._left_m = self._whole_m

    def after(self, step_m: float) -> BodyModel:
        """The next skeleton on the way: no joint and keypoint moves farther than that in its segment."""
        self._left_m -= step_m
        if self._left_m <= 0.0:
            return self.end
        share, end = self._left_m / self._whole_m, self.end
        return replace(end, offset=end.offset - share * self._offset, keypoint_local=end.keypoint_local - share * self._local)


# From one source of a pose to another without a step: for a while it lies between both.


class Fade:
    """Corrections of one person's tracked keypoints (K, 3), in metres, in the order of times."""

    def __init__(self, count: int, duration_s: float) -> None:
        self._last, self._left = np.zeros((2, count, 3))
        self._duration_ns, self._changed_ns = duration_s * 1e9, 0

    def step(self, t_ns: int, wanted: Array, changed: bool) -> Array:
        """The correction at this time, between the wanted one and the last of the source before it.

        When the source has just `changed` it is the same as at the last time step.
        """
        if changed:
            self._left, self._changed_ns = self._last, t_ns
        passed = min((t_ns - self._changed_ns) / self._duration_ns, 1.0)
        # velocity does not step, either
        share = passed * passed * (3.0 - 2.0 * passed)
        self._last = self._left + share * (wanted - self._left)
        return self._last

    def over(self, t_ns: int) -> bool:
        """Whether the wanted correction is reached."""
        return t_ns - self._changed_ns >= self._duration_ns


_FIRST_ITERATIONS, _FIT_ITERATIONS, _TICK_ITERATIONS = 30, 3, 1
# keeps a degree of freedom where it was that nothing measures, radians and metres
_LOOSE_SD = 0.3
# a person who is tracked so far from the skeleton is elsewhere, or another one
_ELSEWHERE_M = 0.3
# nearer to a camera than this nothing is projected
_LEAST_DEPTH_M = 0.05
_AXES = np.eye(3)
# of the Student-t distribution that is a Gaussian
_GAUSSIAN_DOF = 1e12


@dataclass(frozen=True, eq=False, kw_only=True)
class LiveRays:
    """What cameras (V) saw of one person, moved to the time of the pose, at joint centres.

    Attributes:
        projections: (V, 3, 4) to ideal image points. xy: (K, V, 2) these. inverse_var: (K, V) 1 / variance, 0 where unseen.
    """

    projections: Array
    xy: Array
    inverse_var: Array

    @staticmethod
    def moved(projections: Array, z: Array, inverse_var: Array, *, then: Array, now: Array) -> LiveRays:
        """Rays z (V, K, 2) as they would be now: moved by what lies between their points then (V, K, 3) and now (K, 3)."""
        before, after = (xyz @ np.swapaxes(projections[..., :3], 1, 2) + projections[:, None, :, 3] for xyz in (then, now))
        good = (before[..., 2] > _LEAST_DEPTH_M) & (after[..., 2] > _LEAST_DEPTH_M) & np.isfinite(z[..., 0])
        xy = np.where(good[..., None], z + after[..., :2] / after[..., 2:] - before[..., :2] / before[..., 2:], 0.0)
        return LiveRays(
            projections=projections,
            xy=np.ascontiguousarray(np.swapaxes(xy, 0, 1)),
            inverse_var=np.ascontiguousarray(np.where(good, inverse_var, 0.0).T),
        )

    def disagreement(self, points: Array) -> Array:
        """(K,) by how much rays that meet near points (K, 3) are farther apart than stated, as a factor of variance from 1 on.

        The Birge ratio: chi-squared by its degrees of freedom. One ray agrees with any point.
        """
        return variance_factor(squared_misses(points, self.projections, self.xy, self.inverse_var), _GAUSSIAN_DOF)


@dataclass(frozen=True, eq=False, kw_only=True)
class TrackedPoints:
    """One person at one output tick as tracked, at joint centres: (K, 3), (K, 3, 3), and (K,) what was measured lately."""

    t_ns: int
    xyz: Array
    cov: Array
    measured: Array


class LiveBody:
    """Follows one person. Time steps must come in the order of their times.

    Attributes:
        learnt: the skeleton.
        disagreement: (K,) of the newest rays around the tracked keypoints, see `LiveRays`.
    """

    def __init__(
        self, skeleton: Skeleton, settings: BodySettings, live: LiveBodyRules, prior: LengthPrior, work: FrameBuffers
    ) -> None:
        self._settings, self._live, self._work = settings, live, work
        self.learnt = LearntBody(skeleton, settings, live, prior, work)
        self.disagreement = np.ones(len(skeleton))
        self._fit: _Fit | None = None
        self._fade = Fade(len(skeleton), live.fade_s)
        self._due_ns = 0

    def wants_rays(self, t_ns: int) -> bool:
        """Whether the step at this time is to fit rays."""
        return self.learnt.body is not None and t_ns >= self._due_ns

    def step(self, tracked: TrackedPoints, rays: LiveRays | None) -> Array | None:
        """(K, 3) keypoints, NaN where they are not tracked; None where the tracked ones are to come out as they are.

        Of the skeleton, and as tracked those that it does not carry; for a while after a fit began or ended, between both.
        """
        changed = self.learnt.step(tracked.t_ns, tracked.xyz, tracked.cov, tracked.measured)
        body, before = self.learnt.body, self._fit
        if body is None:
            return None
        if self._fit is not None and changed:
            self._fit = self._fit.with_body(body)
        # before the fit follows the person there: what it corrected at the old place still holds
        if self._fit is not None and self._fit.elsewhere(tracked):
            self._fit = None
        if rays is not None:
            self._due_ns = tracked.t_ns + round(self._live.fit_every_s * 1e9)
            self.disagreement = rays.disagreement(tracked.xyz)
            if self._fit is None:
                self._fit = self._started(body, tracked, rays)
            else:
                self._fit.to_rays(tracked, rays, _FIT_ITERATIONS)
        elif self._fit is not None:
            self._fit.follow(tracked)
        wanted = np.zeros_like(tracked.xyz) if self._fit is None else self._fit.correction(tracked.xyz)
        correction = self._fade.step(tracked.t_ns, wanted, self._fit is not before)
        return None if self._fit is None and self._fade.over(tracked.t_ns) else tracked.xyz + correction

    def _started(self, body: BodyModel, tracked: TrackedPoints, rays: LiveRays) -> _Fit | None:
        """From where keypoints are tracked; None without a pelvis."""
        state = guessed_state(body, tree_from_body(body, self._settings), self._work, tracked.xyz[body.keypoint])
        if state is None:
            return None
        fit = _Fit(body, self._settings, self._live, state)
        fit.to_rays(tracked, rays, _FIRST_ITERATIONS)
        return fit


class _Fit:
    """A skeleton in a pose, and how it got there."""

    def __init__(self, body: BodyModel, settings: BodySettings, live: LiveBodyRules, state: tuple[Array, Array]) -> None:
        self._body, self._settings, self._live, self._state = body, settings, live, state
        self._tree = tree_from_body(body, settings)
        self._loose = self._tree.held(1 / _LOOSE_SD**2)
        self._slack = np.array([node.slack for node in body.nodes])
        count = len(body.keypoint)
        # (A, 3) keypoints in the pose, from the first fit on
        self._points = np.full((count, 3), np.nan)
        # (A, 3) from the tracked keypoints to where rays put them
        self._off = np.zeros((count, 3))
        self._feet = StandingFeet(body.skeleton, body.keypoint)
        self._soles = body.keypoint[self._feet.rows]
        self._no_rays = np.zeros((0, 3, 4)), np.zeros((count, 0, 2)), np.zeros((count, 0))

    def with_body(self, body: BodyModel) -> _Fit | None:
        """The same with other lengths; None if it is another tree."""
        if not body.same_tree(self._body):
            return None
        self._body, self._tree = body, self._tree._replace(offset=body.offset, local=body.keypoint_local)
        return self

    def correction(self, xyz: Array) -> Array:
        """(K, 3) from tracked keypoints to those of the skeleton; 0 where either is missing."""
        at, out = self._body.keypoint, np.zeros_like(xyz)
        change = self._points - xyz[at]
        out[at] = np.where(np.isfinite(change), change, 0.0)
        return out

    def to_rays(self, tracked: TrackedPoints, rays: LiveRays, iterations: int) -> None:
        """Fit the pose to rays, and weakly to where keypoints are tracked, because some have none."""
        at = self._body.keypoint
        xyz = tracked.xyz[at]
        put, information, stands = self._with_standing(tracked, xyz, self._live.tracked_share)
        self._solve(fit_kernels.SeenKeypoints(put, information, rays.projections, rays.xy[at], rays.inverse_var[at]), iterations)
        # what holds a foot at its place is not what rays say
        fresh = np.isfinite(xyz[:, :1]) & ~stands[:, None]
        share = 1.0 if iterations == _FIRST_ITERATIONS else self._live.new_share
        self._off += np.where(fresh, share * (self._points - xyz - self._off), 0.0)

    def follow(self, tracked: TrackedPoints) -> None:
        """Move with the tracked keypoints."""
        put, information, _ = self._with_standing(tracked, tracked.xyz[self._body.keypoint] + self._off, 1.0)
        self._solve(fit_kernels.SeenKeypoints(put, information, *self._no_rays), _TICK_ITERATIONS)

    def _with_standing(self, tracked: TrackedPoints, xyz: Array, share: float) -> tuple[Array, Array, Array]:
        """Points (A, 3) to fit, their information (A, 3, 3), and which of them stand and so are put at their places."""
        at, sigma_m = self._body.keypoint, self._settings.contact_sigma_m
        put, known = np.nan_to_num(xyz), np.isfinite(xyz[:, 0])
        information = np.where(known[:, None, None], share * information_of(tracked.cov[at]), 0.0)
        stands = np.zeros(len(at), bool)
        if sigma_m:
            feet = self._feet
            places = feet.step(tracked.t_ns, tracked.xyz[self._soles] + self._off[feet.rows])
            held = feet.rows[feet.stands]
            put[held], information[held], stands[held] = places[feet.stands], _AXES / sigma_m**2, True
        return put, information, stands

    def elsewhere(self, tracked: TrackedPoints) -> bool:
        """Whether the person was found again in another place."""
        away = tracked.xyz[self._body.keypoint] - self._points
        # NaN come last
        squared = np.sort((away * away).sum(axis=1))
        last = int(np.isfinite(squared).sum()) - 1
        return last >= 0 and math.sqrt(squared[last // 2]) + math.sqrt(squared[(last + 1) // 2]) > 2 * _ELSEWHERE_M

    def _solve(self, seen: fit_kernels.SeenKeypoints, iterations: int) -> None:
        q, rot = self._state
        expected = np.where(self._slack, 0.0, q), rot.copy()
        fit_kernels.descend(
            self._tree, expected, self._loose, 1.0, seen, self._settings.robust_dof, 1.0, iterations, q, rot
        )  # fmt: skip
        tree_kernels.put_points(self._tree, q, rot, self._points)
