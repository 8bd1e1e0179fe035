"""What a user may set about smoothing, and the figures that it shares with the live tracker."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt, Le

from posefuse.foundation.settings import settings

# How long errors of a 2D network last: the one place of the figures, for the smoother and the live tracker.
#
# A network that marks a joint a little too high does so in the next frame too. Of the variance of a measurement's error a share
# lasts, fading by e within a time; the rest is new in every frame. Averaging over time only helps against the rest.
#
# Fitted to the default network's fused joints at 30 frames/s on rendered people who appear in no reported measurement:
# `bench/fit_lasting_errors.py` prints 0.91 and 0.27 s. More than half of the share stays for good there; it counts as lasting
# here, which is the same within the fraction of a second that is averaged over.
LASTING_SHARE = 0.9
LASTING_S = 0.27


@settings
class SmoothSettings:
    """How a recording is smoothed.

    Attributes:
        cutoff_hz: frequency at which motion keeps 1/sqrt(2) of its amplitude (-3 dB, no lag), at the typical noise of each
            keypoint. Measurements with more uncertainty are followed less closely. At most 0.35 of the frame rate.
        max_gap_s: longest gap between two measurements that is filled; filled time steps are marked INTERPOLATED.
        outlier_sigma: a measurement this many standard deviations from the estimate of all others is an outlier and is not
            used.
        lasting_share, lasting_s: share of the variance of a measurement that is correlated over time, and the time in which the
            correlation falls to 1/e. Correlated errors do not average out, and the stated covariance includes them. See
            `LASTING_SHARE`.
        bones: keep bone lengths at their values over the whole recording, as tightly as they were constant.
        bone_sigma_m: smallest standard deviation of a bone length.
    """

    cutoff_hz: Annotated[float, Gt(0)] = 6.0
    max_gap_s: Annotated[float, Ge(0)] = 0.5
    outlier_sigma: Annotated[float, Gt(0)] = 6.0
    lasting_share: Annotated[float, Ge(0), Le(1)] = LASTING_SHARE
    lasting_s: Annotated[float, Gt(0)] = LASTING_S
    bones: bool = True
    bone_sigma_m: Annotated[float, Gt(0)] = 0.01
