"""What a user may set about live tracking; each default exists once, here."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt, Le, MaxLen, MinLen

from posefuse.core.duplicate_share import DUPLICATE_SHARE
from posefuse.foundation.settings import settings
from posefuse.tracking.settings import LASTING_SHARE

MOST_PEOPLE = 64


@settings
class MotionModelSettings:
    """One way to move: accelerations of this standard deviation, each of which fades within this time."""

    acceleration_m_s2: Annotated[float, Gt(0)]
    persistence_s: Annotated[float, Gt(0)]


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
        alone_s: a person who was measured by a single camera without depth for this long is dropped, because one ray fits any
            depth.
        alone_hold_s: a person who was measured by a single camera without depth for this long is moved across its line of sight
            only.
        measured_s: a keypoint counts as measured (FUSED) when a view at most this old saw it, otherwise as PREDICTED. It covers
            the time from exposure to the tracker and one frame period.
        lag_s: out-of-order views up to this much older than the newest are still applied at their own time.
        ahead_s: a view with a time stamp further in the future than this has a wrong clock and is not used.
        camera_rate_max_hz: of views of one camera that are closer in time than this rate, only the first is used.
        detections_max: detections used per view, those with the highest score first.
        motion_models: motion models of each keypoint relative to the body, from calm to agile; their weights follow the
            measurements.
        body_models: the same for the body as a whole.
        switch_s: mean time that a keypoint stays in one motion model.
        lasting_share: share of the stated variance of a view that is correlated from frame to frame, see `tracking.settings`;
            the covariance of a pose includes it.
        averaging: how much of the temporally correlated errors is averaged out by filtering over time; with 0 they are stated
            as if the filter used the newest views alone.
        new_share: share of the stated variance of a view that counts as noise new in every view. The rest moves slowly with
            the person, so no filter can separate it from motion; `lasting_share` states it. Motion models, switch_s, averaging
            and new_share are fitted together by `bench/fit_tracker.py`.
        outlier_chi2: squared distance in standard deviations from which a view counts less.
        gate_chi2: squared distance in standard deviations from which a view does not count.
        duplicate_share: two detections of one view are the same body when the median distance of their keypoints is below this
            share of their box.
        tolerance_m: largest distance, at the body, between a keypoint and its prediction for a detection to belong to a person.
        min_share: share of the keypoints of a detection that must be that close.
        score_min: keypoints with a lower score are not used.
        sigma_share: standard deviation of a keypoint of score 1 for networks that state none, as a share of the extent of the
            body.
        bone_sigma_m: standard deviation of bone lengths as this network measures them.
    """

    max_people: Annotated[int, Ge(1), Le(MOST_PEOPLE)] = 1
    lost_after_s: Annotated[float, Gt(0)] = 0.7
    shown_s: Annotated[float, Gt(0)] = 0.3
    alone_s: Annotated[float, Gt(0)] = 1.5
    alone_hold_s: Annotated[float, Gt(0)] = 0.5
    measured_s: Annotated[float, Gt(0)] = 0.16
    lag_s: Annotated[float, Gt(0), Le(5)] = 0.3
    ahead_s: Annotated[float, Gt(0)] = 0.5
    camera_rate_max_hz: Annotated[float, Gt(0), Le(1000)] = 250.0
    detections_max: Annotated[int, Ge(1)] = 16
    motion_models: Annotated[tuple[MotionModelSettings, ...], MinLen(1), MaxLen(6)] = (
        MotionModelSettings(acceleration_m_s2=0.2, persistence_s=0.1),
        MotionModelSettings(acceleration_m_s2=0.91, persistence_s=0.1),
        MotionModelSettings(acceleration_m_s2=4.3, persistence_s=0.1),
        MotionModelSettings(acceleration_m_s2=20.0, persistence_s=0.1),
    )
    body_models: Annotated[tuple[MotionModelSettings, ...], MinLen(1), MaxLen(6)] = (
        MotionModelSettings(acceleration_m_s2=0.2, persistence_s=0.77),
        MotionModelSettings(acceleration_m_s2=0.71, persistence_s=0.77),
        MotionModelSettings(acceleration_m_s2=2.5, persistence_s=0.77),
        MotionModelSettings(acceleration_m_s2=9.0, persistence_s=0.77),
    )
    switch_s: Annotated[float, Gt(0)] = 1.0
    lasting_share: Annotated[float, Ge(0), Le(1)] = LASTING_SHARE
    averaging: Annotated[float, Ge(0)] = 0.067
    new_share: Annotated[float, Gt(0), Le(1)] = 0.36
    outlier_chi2: Annotated[float, Gt(0)] = 9.0
    gate_chi2: Annotated[float, Gt(0)] = 36.0
    duplicate_share: Annotated[float, Ge(0), Le(1)] = DUPLICATE_SHARE
    tolerance_m: Annotated[float, Gt(0)] = 0.2
    min_share: Annotated[float, Gt(0), Le(1)] = 0.4
    score_min: Annotated[float, Ge(0), Le(1)] = 0.1
    sigma_share: Annotated[float, Gt(0)] = 0.015
    bone_sigma_m: Annotated[float, Gt(0)] = 0.015
