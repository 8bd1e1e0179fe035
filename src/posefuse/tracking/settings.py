"""What a user may set about smoothing and live tracking, and the figures that both share."""

from __future__ import annotations

from dataclasses import dataclass
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


MOST_PEOPLE = 64


@settings
class LiveSettings:
    """How people are followed live, from views that arrive at any time: each view is applied at its own time, and the pose is
    predicted to the output time.

    Attributes:
        max_people: how many people to follow at a time.
        lost_after_s: a keypoint is missing when no view measured it for this long; a person is dropped when that holds for all
            keypoints.
        shown_s: of several people, one that no view measured for this long is not in the output, but is still expected until
            `lost_after_s`: hidden or gone.
        lag_s: out-of-order views up to this much older than the newest are still applied at their own time.
    """

    max_people: Annotated[int, Ge(1), Le(MOST_PEOPLE)] = 1
    lost_after_s: Annotated[float, Gt(0)] = 0.7
    shown_s: Annotated[float, Gt(0)] = 0.3
    lag_s: Annotated[float, Gt(0), Le(5)] = 0.3


@dataclass(frozen=True)
class MotionModel:
    """One way to move: accelerations of this standard deviation (m/s^2), each of which fades within this time (s)."""

    acceleration_m_s2: float
    persistence_s: float


@dataclass(frozen=True, kw_only=True)
class LiveMotion:
    """How people move and what a view is worth. Not settings: `bench/fit_tracker.py` fitted those that it names, together.

    Attributes:
        keypoints: motion models of each keypoint relative to the body, from calm to agile; their weights follow the
            measurements (fitted).
        body: the same for the body as a whole, as many (fitted).
        switch_s: mean time that a keypoint stays in one motion model (fitted).
        averaging: how much of the temporally correlated errors is averaged out by filtering over time; with 0 they are stated
            as if the filter used the newest views alone (fitted).
        new_share: share of the stated variance of a view that counts as noise new in every view. The rest moves slowly with
            the person, so no filter can separate it from motion; `lasting_share` states it (fitted).
        lasting_share: share of the stated variance of a view that is correlated from frame to frame, see `tracking.settings`;
            the covariance of a pose includes it.
        measured_s: a keypoint counts as measured (FUSED) when a view at most this old saw it, otherwise as PREDICTED. It covers
            the time from exposure to the tracker and one frame period.
        alone_s: a person who was measured by a single camera without depth for this long is dropped, because one ray fits any
            depth.
        alone_hold_s: such a person is moved across the line of sight only, after this long.
        outlier_chi2: squared distance in standard deviations from which a view counts less.
        gate_chi2: squared distance in standard deviations from which a view does not count.
        bone_sigma_m: standard deviation of bone lengths as networks measure them.
    """

    keypoints: tuple[MotionModel, ...] = (
        MotionModel(0.2, 0.1), MotionModel(0.91, 0.1), MotionModel(4.3, 0.1), MotionModel(20.0, 0.1),
    )  # fmt: skip
    body: tuple[MotionModel, ...] = (
        MotionModel(0.2, 0.77), MotionModel(0.71, 0.77), MotionModel(2.5, 0.77), MotionModel(9.0, 0.77),
    )  # fmt: skip
    switch_s: float = 1.0
    averaging: float = 0.067
    new_share: float = 0.36
    lasting_share: float = LASTING_SHARE
    measured_s: float = 0.16
    alone_s: float = 1.5
    alone_hold_s: float = 0.5
    outlier_chi2: float = 9.0
    gate_chi2: float = 36.0
    bone_sigma_m: float = 0.015


MOTION = LiveMotion()
