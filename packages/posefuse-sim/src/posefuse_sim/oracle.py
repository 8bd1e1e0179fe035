"""A detector that knows the ground truth and adds errors as configured: tests and studies without a network or an image.

It answers by camera name and frame time from `core.Truth`. What it draws depends on seed, camera and time alone, not on
the order of questions, so a replay gives the same numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le

from posefuse.core import CameraTruth, Detections2D, Frame, InputError, Region, Truth
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.core.view_sequences import ViewSequence
from posefuse.detection.crops import check_regions, nearest_to
from posefuse.formats.truth import read_truth
from posefuse.foundation.settings import settings

_FAR_TIME_NS = 1_000_000
_OUTLIER_SCORES = (0.2, 0.9)
_VISIBLE_SCORE = 0.95


@settings
class OracleNoise:
    """How the oracle errs.

    Attributes:
        sigma_px: standard deviation of each coordinate of a visible keypoint.
        hidden_factor: times sigma_px for a hidden keypoint. hidden_score: its score, where a visible one has 0.95.
        bias_px: constant error of each coordinate, drawn once per camera and keypoint with this standard deviation.
        outlier_share: of keypoints that land anywhere within outlier_px of the truth with a score that does not show it.
        outlier_px: half the side of that square.
        swap_share: of (person, frame) whose left and right are swapped.
        miss_share: of (person, frame) not seen at all.
    """

    sigma_px: Annotated[float, Gt(0)] = 3.0
    hidden_factor: Annotated[float, Ge(1)] = 4.0
    hidden_score: Annotated[float, Gt(0), Le(1)] = 0.3
    bias_px: Annotated[float, Ge(0)] = 0.0
    outlier_share: Annotated[float, Ge(0), Le(1)] = 0.0
    outlier_px: Annotated[float, Gt(0)] = 80.0
    swap_share: Annotated[float, Ge(0), Le(1)] = 0.0
    miss_share: Annotated[float, Ge(0), Le(1)] = 0.0


@settings
class OracleConfig:
    """The oracle as a plug-in.

    Attributes:
        truth: a truth file (``truth.npz`` of a simulated session). noise: how to err. seed: of everything drawn.
    """

    truth: Path
    noise: OracleNoise = OracleNoise()
    seed: Annotated[int, Ge(0)] = 0

    def build(self) -> OracleDetector:
        """Read the truth; raises InputError when that cannot be done."""
        return OracleDetector(read_truth(self.truth), self.noise, self.seed)


class OracleDetector:
    """Implements `core.Detector` from a `Truth`; images are not looked at.

    Args:
        truth: views of every camera that will be asked for.
        noise: how to err.
        seed: of everything drawn.
    """

    def __init__(self, truth: Truth, noise: OracleNoise | None = None, seed: int = 0) -> None:
        self._truth, self._noise, self._seed = truth, noise or OracleNoise(), seed
        self._place = {view.camera: c for c, view in enumerate(truth.views)}
        # the truth's keypoints are joint centres
        self.skeleton, self.joint_centres = truth.skeleton, None

    def detect(self, frames: Sequence[Frame], regions: Sequence[Sequence[Region] | None]) -> list[Detections2D]:
        """All visible people; with regions, for each region the person whose centre is inside and nearest to its centre.

        Raises:
            InputError: a camera the truth does not know, or a frame more than 1 ms from any of its frames.
        """
        check_regions(frames, regions)
        return [self._one(frame.camera, frame.t_ns, given) for frame, given in zip(frames, regions, strict=True)]

    def _one(self, camera: str, t_ns: int, given: Sequence[Region] | None) -> Detections2D:
        if camera not in self._place:
            raise InputError(f"oracle: no camera {camera!r} in the truth; there are: {choices(self._place)}")
        c = self._place[camera]
        frame = _frame_at(self._truth.views[c], t_ns)
        xy, score, sigma = _erring_view(self._truth, c, frame, self._noise, self._seed)
        if given is not None:
            xy, score, sigma = _in_regions(xy, score, sigma, given)
        else:
            seen = (score > 0).any(-1)
            xy, score, sigma = xy[seen], score[seen], sigma[seen]
        return Detections2D.of(camera, t_ns, self.skeleton, xy, score, sigma)


def oracle_views(truth: Truth, noise: OracleNoise, seed: int = 0) -> ViewSequence:
    """The detections of `OracleDetector` for every frame together, of cameras with as many frames as there are true poses."""
    parts = [[_erring_view(truth, c, f, noise, seed) for c in range(len(truth.views))] for f in range(len(truth.t_ns))]
    xy, score, sigma = (np.array([np.stack([view[i] for view in frame], axis=1) for frame in parts]) for i in range(3))
    return ViewSequence(
        t_ns=truth.t_ns, skeleton=truth.skeleton, camera_names=truth.rig.names, person_id=truth.person_id, xy_img=xy, score=score,
        sigma_px=sigma,
    )  # fmt: skip


def _frame_at(view: CameraTruth, t_ns: int) -> int:
    if not len(view.t_ns):
        raise InputError(f"oracle: camera {view.camera}: the truth holds no frame of it")
    frame = int(np.abs(view.t_ns - t_ns).argmin())
    off_ns = abs(int(view.t_ns[frame]) - t_ns)
    if off_ns > _FAR_TIME_NS:
        raise InputError(
            f"oracle: camera {view.camera}: no true frame within 1 ms of {t_ns} ns; the nearest is {off_ns} ns away; "
            "where its clock has an offset or drift in the scene, state their negatives as offset_s and drift_ppm "
            "in the session's posefuse.toml"
        )
    return frame


def _erring_view(truth: Truth, c: int, frame: int, noise: OracleNoise, seed: int) -> tuple[Array, Array, Array]:
    """xy (N, K, 2), score (N, K), sigma (N, K) of one camera's frame."""
    visible, exact = truth.views[c].visible[frame], truth.views[c].xy_img[frame]
    bias = np.random.default_rng([seed, c]).normal(0, noise.bias_px, exact.shape[1:])
    rng = np.random.default_rng([seed, c, frame])
    normal = rng.standard_normal(exact.shape)
    outlier = rng.random(visible.shape) < noise.outlier_share
    far = rng.uniform(-1, 1, exact.shape) * noise.outlier_px
    lucky = rng.uniform(*_OUTLIER_SCORES, visible.shape)
    swapped, missed = (rng.random(len(visible)) < share for share in (noise.swap_share, noise.miss_share))
    sigma = np.where(visible, noise.sigma_px, noise.sigma_px * noise.hidden_factor)
    xy = exact + bias + np.where(outlier[..., None], far, normal * sigma[..., None])
    score = np.where(outlier, lucky, np.where(visible, _VISIBLE_SCORE, noise.hidden_score))
    # a network that swaps sides is as sure of itself as ever: points and scores travel together
    turn = truth.skeleton.mirror
    xy = np.where(swapped[:, None, None], xy[:, turn], xy)
    score, sigma = (np.where(swapped[:, None], a[:, turn], a) for a in (score, sigma))
    gone = missed[:, None] | ~np.isfinite(xy).all(-1)
    return np.where(gone[..., None], np.nan, xy), np.where(gone, 0.0, score), np.where(gone, np.nan, sigma)


def _in_regions(xy: Array, score: Array, sigma: Array, regions: Sequence[Region]) -> tuple[Array, Array, Array]:
    """For each region the person whose middle is nearest to its centre and within half its side; NaN for no person."""
    shape = (len(regions), *xy.shape[1:])
    out_xy, out_score, out_sigma = np.full(shape, np.nan), np.zeros(shape[:-1]), np.full(shape[:-1], np.nan)
    seen = np.flatnonzero((score > 0).any(-1))
    middle = np.array([np.nanmean(xy[n], axis=0) for n in seen]).reshape(-1, 2)
    for r, region in enumerate(regions):
        place = nearest_to(region, middle, 0.5)
        if place is not None:
            n = seen[place]
            out_xy[r], out_score[r], out_sigma[r] = xy[n], score[n], sigma[n]
    return out_xy, out_score, out_sigma
