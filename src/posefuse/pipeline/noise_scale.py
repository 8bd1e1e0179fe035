"""How much larger or smaller the errors of a network are in a recording than its noise states, from what cameras disagree on.

The Birge ratio (Birge 1932, "The calculation of errors by the method of least squares"): the root of chi-square over its degrees
of freedom. Here it is a median over joints and time steps whose views agree. Errors that all cameras share are not seen by it.
"""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
from scipy.special import gammaincinv

from posefuse.calibration.keypoints import limb_keypoints
from posefuse.core import Observations, Recording, Rig
from posefuse.foundation.parsing import plain
from posefuse.fusion import FuseSettings

from .config import TrackConfig
from .solve import solve_followed

# fewer joints in a time step, seen by enough cameras, say nothing; and beyond these limits it is not the noise that is wrong
_LEAST_SEEN = 200
_LIMITS = (0.5, 3.0)
# more add nothing
_TIME_STEPS = 1000


def noise_scale(observations: Observations, rig: Rig, fuse: FuseSettings) -> float | None:
    """By what the stated standard deviations are to be multiplied, from 0.5 to 3; None where too little is seen.

    Raises:
        InputError: no person could be followed.
    """
    every = max(1, len(observations.step_t_ns) // _TIME_STEPS)
    some = observations.only(observations.frame_step % every == 0)
    some = replace(some, step_t_ns=some.step_t_ns[::every], frame_step=some.frame_step // every)
    config = TrackConfig(fuse=fuse, raw=True, joint_centres=False, body="off")
    return _birge_ratio(solve_followed(some, rig, {"config": plain(asdict(config))}), fuse.score_min)


def _birge_ratio(fused: Recording, score_min: float) -> float | None:
    views, limbs = fused.views, limb_keypoints(fused.poses.skeleton.keypoints)
    exact = np.moveaxis(fused.rig.project(fused.poses.xyz_world[..., limbs, :]), 0, 2)
    off = (views.xy_img[..., limbs, :] - exact) / views.sigma_px[..., limbs, None]
    used = np.isfinite(off).all(axis=-1) & (views.score[..., limbs] >= score_min)
    count = used.sum(axis=2)
    # coordinates that were seen less those of the joint
    freedom = 2 * count - 3
    known = (freedom > 0) & (count == fused.poses.n_views[..., limbs])
    if known.sum() < _LEAST_SEEN:
        return None
    chi2 = (np.where(used[..., None], off, 0.0) ** 2).sum(axis=(2, 4))[known]
    ratio = np.median(chi2 / (2 * gammaincinv(freedom[known] / 2, 0.5)))
    return float(np.clip(np.sqrt(ratio), *_LIMITS))
