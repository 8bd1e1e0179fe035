"""What a user may set about live tracking; each default exists once, here."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen

from posefuse.core.duplicates import DUPLICATE_SHARE
from posefuse.foundation.settings import settings
from posefuse.tracking.lasting import LASTING_SHARE

TrackerName = Literal["asynchronous", "latest"]
TRACKERS: tuple[TrackerName, ...] = ("asynchronous", "latest")


@settings
class MotionModelSettings:
    """One way to move: accelerations of this standard deviation, each of which fades within this time."""

    acceleration_m_s2: Annotated[float, Gt(0)]
    persistence_s: Annotated[float, Gt(0)]


@settings
class LiveSettings:
    """How people are followed live, from views that come when they can.

    Attributes:
        tracker: ``asynchronous`` (every view counts at its own time, the pose is predicted to the output time), or the
            paper's ``latest`` (the newest view of each camera, fused as if they were of one moment).
        max_people: how many people to follow at a time.
        lost_after_s: a keypoint is missing, and a person gone, when no view measured it for so long.
        shown_s: of several people, one whom no view measured for so long is not in the output, but still expected until
            `lost_after_s`: hidden or gone.
        alone_s: a person is gone, too, when one camera alone measured them for so long: its rays fit any depth.
        measured_s: a keypoint counts as measured (FUSED) when a view not older than this saw it, else PREDICTED. It spans
            what a view needs from exposure to here, and one period of a camera.
        lag_s: views that come up to so much late, seen from the newest, are worked in at their own time.
        ahead_s: a view from further in the future than this has a wrong clock and is not used.
        camera_rate_max_hz: of one camera's views closer in time than this only the first is used.
        detections_max: people looked at in one view, the surest first.
        motion_models: run side by side for every keypoint against the body, from calm to agile; the views tell how much of
            each it is. body_models: as many, for the body as a whole.
        switch_s: how long a keypoint stays in one of them.
        lasting_share: share of a view's stated variance that lasts from frame to frame, see `track.lasting`: poses state it.
        averaging: how much of what lasting errors do to a pose counts as averaged away by looking back; with 0 they are stated
            as if the filter only knew the newest views.
        learnt_share: share of a view's variance that is taken for an error of this camera alone and learnt, and learnt_s: for
            how long such an error lasts. Less than what lasts, as slow motion must not be taken for it. Models, switch_s,
            averaging and these two are fitted together by `bench/fit_tracker.py`.
        outlier_chi2: squared distance in sigmas from which a view pulls less. gate_chi2: from which it does not pull at all.
        duplicate_share: two detections of one view whose keypoints are closer than this share of their box (median) are one
            body.
        tolerance_m: how far, at the body, a keypoint may lie from where it is expected for its view to be this person's.
        min_share: share of a detection's keypoints that must do so.
        score_min: keypoints below it are not used.
        sigma_share: noise of a keypoint of score 1 where the network states none, as a share of the body's extent.
        bone_sigma_m: how constant the lengths of bones are, as this network sees them.
    """

    tracker: TrackerName = "asynchronous"
    max_people: Annotated[int, Ge(1), Le(64)] = 1
    lost_after_s: Annotated[float, Gt(0)] = 0.7
    shown_s: Annotated[float, Gt(0)] = 0.3
    alone_s: Annotated[float, Gt(0)] = 1.5
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
    averaging: Annotated[float, Ge(0)] = 0.1
    learnt_share: Annotated[float, Ge(0), Lt(1)] = 0.6
    learnt_s: Annotated[float, Gt(0)] = 1.8
    outlier_chi2: Annotated[float, Gt(0)] = 9.0
    gate_chi2: Annotated[float, Gt(0)] = 36.0
    duplicate_share: Annotated[float, Ge(0), Le(1)] = DUPLICATE_SHARE
    tolerance_m: Annotated[float, Gt(0)] = 0.2
    min_share: Annotated[float, Gt(0), Le(1)] = 0.4
    score_min: Annotated[float, Ge(0), Le(1)] = 0.1
    sigma_share: Annotated[float, Gt(0)] = 0.015
    bone_sigma_m: Annotated[float, Gt(0)] = 0.015
