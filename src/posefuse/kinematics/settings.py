"""Settings of segment frames and joint angles, and of the whole-body fit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt

from posefuse.foundation.settings import settings


@settings
class JointSettings:
    """How frames and angles behave where the points leave them open.

    Attributes:
        turn_rate_rad_sqrt_s: how fast the plane of a limb wanders unseen: standard deviation after one second.
        hinge_play_rad: how far a knee or elbow departs from an ideal hinge; limits the trust in the plane of a nearly
            straight limb.
    """

    turn_rate_rad_sqrt_s: Annotated[float, Gt(0)] = 0.7
    hinge_play_rad: Annotated[float, Ge(0)] = 0.05


@settings
class BodySettings:
    """How the skeleton may move and how far its points are trusted.

    Attributes:
        joint_limits: keep joints inside the range of a human (softly).
        turn_accel_rad_s15: white angular acceleration of every joint, square root of its spectral density.
        noise_memory_s: errors of keypoints this close in time are taken as the same error, which must not average out. Errors
            of the default network last 0.27 s (`bench/fit_lasting_errors.py`), but by then joints have moved on: with that,
            knees of walking people bend too little.
        offset_sigma_m: how far a keypoint may lie from its joint for good, in each direction: no time averages that out, so it is
            in every covariance. The default covers the errors of the default network on bodies of random seeds 7300 to 7309
            (walking, squatting, reaching, waving, T-pose; 90 % intervals).
        hip_sigma_m: the same of hips, which no detector sees.
        most_sigma_m: a joint that was not measured and is less certain than this is missing, not filled in.
        contact_sigma_m: how far a point of a standing foot may be from its place on the floor, in a recorded fit to rays; 0:
            feet may move and sink at any time.
        length_steps: segment lengths are solved from so many time steps, spread over the recording.
        robust_dof: degrees of freedom of the Student-t noise; small forgives outliers.
    """

    joint_limits: bool = True
    turn_accel_rad_s15: Annotated[float, Gt(0)] = 20.0
    noise_memory_s: Annotated[float, Ge(0)] = 0.1
    offset_sigma_m: Annotated[float, Ge(0)] = 0.005
    hip_sigma_m: Annotated[float, Ge(0)] = 0.007
    most_sigma_m: Annotated[float, Gt(0)] = 0.1
    contact_sigma_m: Annotated[float, Ge(0)] = 0.004
    length_steps: Annotated[int, Ge(1)] = 40
    robust_dof: Annotated[float, Gt(0)] = 2.0


@dataclass(frozen=True, kw_only=True)
class LiveBodyRules:
    """How a skeleton is learnt and followed live. Not settings: chosen on development scenes with `bench/live_rendered.py`.

    Attributes:
        learn_s: the first lengths come from so many seconds of tracked poses; they are refined after twice, four times ... as
            many. learn_most_s: lengths are final after so long.
        sample_every_s: poses for it are so far apart at least. sure_m: keypoints with a larger standard deviation do not count.
        length_sigma_m: standard deviation of a segment's length in tracked poses; how far the prior counts.
        length_rate_m_s: refined lengths are approached this slowly, so that no pose jumps.
        fit_every_s: the pose is fitted to rays this often.
        tracked_share: how much a tracked keypoint counts in that fit, as a share of its stated information: it is made of the
            same rays, and of those before.
        new_share: how much of the difference from the tracked keypoints is taken from the newest fit, the rest from those before.
        fade_s: after a fit began or ended, the pose passes so long from the tracked to the fitted one, or back.
    """

    learn_s: float = 1.0
    learn_most_s: float = 32.0
    sample_every_s: float = 0.05
    sure_m: float = 0.05
    length_sigma_m: float = 0.01
    length_rate_m_s: float = 0.005
    fit_every_s: float = 0.03
    tracked_share: float = 0.1
    new_share: float = 0.5
    fade_s: float = 0.2


LIVE_BODY = LiveBodyRules()
