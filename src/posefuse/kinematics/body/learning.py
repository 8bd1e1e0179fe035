"""A skeleton learnt while its person is followed: from few time steps at first, refined as more are seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.core import Kind, PoseSequence, Skeleton
from posefuse.core.arrays import Array
from posefuse.kinematics.joints import FrameBuffers

from .model import BodyModel, body_from_frames
from .settings import BodySettings, LiveBodyRules
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
        self._samples.append((t_ns, known, cov, self._work.frames_alone(known)))
        self._seen_s += self._every_ns * 1e-9
        if len(self._samples) > _MOST_SAMPLES:
            del self._samples[::2]
            self._every_ns *= 2
        return True

    def _learn(self) -> None:
        t_ns, xyz, cov, frames = (np.array(column) for column in zip(*self._samples, strict=True))
        seen = np.isfinite(xyz[..., 0])
        sequence = PoseSequence(
            t_ns=t_ns,
            skeleton=self._skeleton,
            person_id=np.zeros(1),
            xyz_world=xyz[:, None],
            cov_world=np.where(seen[..., None, None], cov, np.nan)[:, None],
            reproj_px=np.where(seen, 0.0, np.nan)[:, None],
            n_views=2 * seen[:, None],
            kind=Kind.FUSED * seen[:, None],
        )
        body = body_from_frames(sequence, 0, frames, self._settings)
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
