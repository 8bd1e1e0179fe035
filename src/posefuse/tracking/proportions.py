"""Offsets of joint centres from the keypoints of detectors whose offsets are not fitted, from people's proportions.

Detectors mark joints where they seem to be on the surface of the body, so segments come out too short or too long, while people's
segments are known shares of their stature, each with a spread. Both together give the probable offset of a keypoint: of
Gaussian offsets along limbs, seen through the lengths they change, the conditional mean is linear in the lengths measured in the
recording. So the result is an ordinary `JointCentres` table: no offset for a person of usual proportions, and slopes.
"""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

import numpy as np
from annotated_types import Gt

from posefuse.core import Detector, JointCentres, Skeleton
from posefuse.core.arrays import Array
from posefuse.core.joint_centres import SEGMENT_ENDS
from posefuse.foundation.settings import settings

Positive = Annotated[float, Gt(0)]
# keypoint sets of detectors trained on marks of annotators; others are joint centres, or have a table fitted to their network
MARKED_SETS = ("coco17", "body_25", "body_25b", "halpe_26", "coco_wholebody_133", "halpe_136")
# metres longer of segments per metre that a joint is moved along a direction; upper arms 40 degrees from the spine, elbows flexed
# by 40 degrees, knees by 20
_SHOULDER = _ELBOW = float(np.cos(np.deg2rad(40.0)))
_KNEE = float(np.cos(np.deg2rad(20.0)))
_LENGTHENS: dict[tuple[str, str], dict[str, float]] = {
    ("shoulder", "outward"): {"shoulders": 2.0},
    ("shoulder", "up"): {"trunk": 1.0, "upper_arm": _SHOULDER},
    ("elbow", "upper_arm"): {"upper_arm": 1.0, "forearm": -_ELBOW},
    ("wrist", "forearm"): {"forearm": 1.0},
    ("hip", "outward"): {"hips": 2.0},
    ("hip", "up"): {"trunk": -1.0, "thigh": 1.0},
    ("knee", "thigh"): {"thigh": 1.0, "shank": -_KNEE},
    ("ankle", "shank"): {"shank": 1.0},
}


def _shares() -> dict[str, float]:
    return {
        "upper_arm": 0.160, "forearm": 0.150, "thigh": 0.240, "shank": 0.247, "shoulders": 0.196, "hips": 0.107, "trunk": 0.292,
    }  # fmt: skip


def _spreads() -> dict[str, float]:
    return {
        "upper_arm": 0.04, "forearm": 0.04, "thigh": 0.05, "shank": 0.05, "shoulders": 0.06, "hips": 0.08, "trunk": 0.08,
    }  # fmt: skip


def _offsets() -> dict[str, dict[str, float]]:
    return {
        "shoulder": {"outward": 0.015, "up": 0.02},
        "elbow": {"upper_arm": 0.035},
        "wrist": {"forearm": 0.045},
        "hip": {"outward": 0.025, "up": 0.02},
        "knee": {"thigh": 0.02},
        "ankle": {"shank": 0.01},
    }


@settings
class Proportions:
    """What is known about people and about detectors before anything is measured.

    Attributes:
        stature_m, stature_sigma_m: adults of both sexes.
        share: segment of `SEGMENT_ENDS`, between joint centres, as a share of stature. Means of de Leva 1996 (joint centres; J.
            Biomech. 29:1223) and Drillis and Contini 1966 (as in Winter, Biomechanics and Motor Control of Human Movement),
            rounded; shoulders and hips, which those give between landmarks of the bones, as in the simulator's bodies.
        spread: standard deviation of a segment among people of the same stature, as a share of its length; what the sources
            disagree by included. The trunk ends at the shoulders, which rise by several centimetres with the arms.
        offset_m: joint -> direction -> standard deviation of how far a detector's mark lies from the joint centre. Needham et al.
            2021 (Sci. Rep. 11:20673) report 30 to 50 mm in all directions together for hips and knees, 1 to 15 mm for ankles.
    """

    stature_m: Positive = 1.70
    stature_sigma_m: Positive = 0.10
    share: dict[str, float] = field(default_factory=_shares)
    spread: dict[str, float] = field(default_factory=_spreads)
    offset_m: dict[str, dict[str, float]] = field(default_factory=_offsets)


def proportional_joint_centres(skeleton: Skeleton, known: Proportions | None = None) -> JointCentres | None:
    """The table for a keypoint set; None for sets whose points are joint centres, or not a whole body.

    Args:
        skeleton: the keypoint set.
        known: about people and detectors; None: the defaults.
    """
    if skeleton.name not in MARKED_SETS:
        return None
    known = known or Proportions()
    gain, _ = conditional_offsets(known)
    usual = {segment: known.stature_m * known.share[segment] for segment in SEGMENT_ENDS}
    offsets: dict[str, dict[str, float]] = {}
    slopes: dict[str, dict[str, dict[str, float]]] = {}
    for (joint, direction), row in zip(_LENGTHENS, gain, strict=True):
        offsets.setdefault(joint, {})[direction] = 0.0
        slopes.setdefault(joint, {})[direction] = dict(zip(SEGMENT_ENDS, row.tolist(), strict=True))
    made_by = f"{skeleton.name}, by the usual body proportions of people (fitted to no network)"
    return JointCentres(made_by=made_by, offsets=offsets, lengths=usual, by_length=slopes)


def joint_centres_of(detector: Detector, *, proportions: bool) -> JointCentres | None:
    """Where joint centres lie relative to a detector's keypoints: fitted to it, or with `proportions` from body proportions."""
    if detector.joint_centres is not None:
        return detector.joint_centres
    return proportional_joint_centres(detector.skeleton) if proportions else None


def usual_lengths(known: Proportions | None = None) -> tuple[Array, Array]:
    """Mean (S,) and covariance (S, S) of people's segments in metres: stature and what segments differ by at one stature."""
    known = known or Proportions()
    share, spread = (np.array([values[segment] for segment in SEGMENT_ENDS]) for values in (known.share, known.spread))
    mean = known.stature_m * share
    return mean, np.outer(share, share) * known.stature_sigma_m**2 + np.diag((spread * mean) ** 2)


def conditional_offsets(known: Proportions) -> tuple[Array, Array]:
    """Metres per metre of unusual length (D, S), and covariance (D, D) of the offsets that are left, in the order of the table.

    Lengths as measured are those between joint centres, minus the effect of the offsets: L = usual + people's deviation - A b.
    """
    _, people = usual_lengths(known)
    lengthens = np.array([[added.get(segment, 0.0) for segment in SEGMENT_ENDS] for added in _LENGTHENS.values()]).T
    prior = np.diag([known.offset_m[joint][direction] ** 2 for joint, direction in _LENGTHENS])
    measured = people + lengthens @ prior @ lengthens.T
    gain = -prior @ lengthens.T @ np.linalg.inv(measured)
    return gain, prior + gain @ lengthens @ prior


def offset_sigma_m(known: Proportions | None = None) -> dict[str, dict[str, float]]:
    """Standard deviation of the offset that is left, by joint and direction: what the table does not know, in metres."""
    _, covariance = conditional_offsets(known or Proportions())
    sigma: dict[str, dict[str, float]] = {}
    for (joint, direction), value in zip(_LENGTHENS, np.sqrt(np.diag(covariance)), strict=True):
        sigma.setdefault(joint, {})[direction] = float(value)
    return sigma
