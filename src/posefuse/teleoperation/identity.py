"""Is this still the same body, with the same hands? A view is compared with what was seen last of each part, however long ago."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core.arrays import Array

from .checks import FINE, Finding
from .hands import TRUNK
from .settings import GateSettings
from .values import OperatorView

# of a trunk: ISO 13855 has it for walking; a longer absence does not make a longer step of a trunk credible
_WALK_MPS, _ABSENCE_S = 1.6, 0.1
# steps beyond these speeds: of the walker of examples/demo, found by blazepose_lite and tracked, those of the trunk (the mean of
# its keypoints) are 15 mm at most, and those of a wrist 56 mm
_TRUNK_STEP_M, _HAND_STEP_M = 0.06, 0.1
# share of a new length in the running mean
_NEW = 0.003


@dataclass(frozen=True, eq=False, kw_only=True)
class SeenBody:
    """What was seen last of a person, and when; NaN: never.

    Attributes:
        person_id: whose. hand_xyz, other_xyz: (H, 3) hands and the wrists of the other arms, seen together at hand_ns.
        trunk_xyz: (4, 3) `hands.TRUNK`, each seen at trunk_ns (4,).
        lengths_m: (H + 1,) of the forearms, and from the middle of the shoulders to that of the hips: running means.
    """

    person_id: int
    hand_xyz: Array
    other_xyz: Array
    hand_ns: int
    trunk_xyz: Array
    trunk_ns: Array
    lengths_m: Array


def seen_in(view: OperatorView, hands_known: bool, settings: GateSettings) -> SeenBody:
    """What one view shows; `hands_known`: there is no doubt about the hands in it."""
    trunk, sigma_m = view.body_xyz_world[TRUNK], view.body_sigma_m[TRUNK]
    sure = view.body_measured[TRUNK] & (sigma_m <= settings.hold_sigma_m) & np.isfinite(trunk).all(axis=1)
    trunk = np.where(sure[:, None], trunk, np.nan)
    here = 1.0 if hands_known else np.nan
    length = np.linalg.norm(trunk[:2].mean(axis=0) - trunk[2:].mean(axis=0))
    return SeenBody(
        person_id=view.person_id,
        hand_xyz=here * view.xyz_world,
        other_xyz=here * view.other_xyz_world,
        hand_ns=view.t_ns,
        trunk_xyz=trunk,
        trunk_ns=np.full(4, view.t_ns),
        lengths_m=np.array([*(here * view.forearm_m), length]),
    )


def continuity_finding(known: SeenBody, now: SeenBody, settings: GateSettings) -> Finding:
    """The view shows the body and the hand that are known; else it ends the engagement. A hand that is only too fast: HOLD."""
    if now.person_id != known.person_id:
        return _ends("another person")
    trunk, absent_s = _length(now.trunk_xyz - known.trunk_xyz), (now.trunk_ns - known.trunk_ns) / 1e9
    both = np.isfinite(trunk)
    if both.any() and (trunk - _WALK_MPS * np.clip(absent_s, 0.0, _ABSENCE_S))[both].mean() > _TRUNK_STEP_M:
        return _ends("the trunk jumped: another body")
    hand, other = _length(now.hand_xyz - known.hand_xyz), _length(now.other_xyz - known.other_xyz)
    # a hand that was hidden may be elsewhere, where the trunk shows that it is the same person's
    longest_s = settings.reengage_s if both.any() else _ABSENCE_S
    too_far_m = hand - settings.hand_speed_mps * np.clip((now.hand_ns - known.hand_ns) / 1e9, 0.0, longest_s)
    if (too_far_m > _HAND_STEP_M).any():
        return _ends("the hand jumped")
    if (_length(now.hand_xyz - known.other_xyz) + _length(now.other_xyz - known.hand_xyz) < hand + other).any():
        return _ends("left and right hand were exchanged")
    share = np.append(np.full(len(hand), settings.forearm_share), settings.trunk_share)
    if (np.abs(now.lengths_m - known.lengths_m) > share * known.lengths_m).any():
        return _ends("forearm or trunk of another length: another body or hand")
    return Finding(0.0, "the hand is too fast") if (too_far_m > settings.hand_step_m).any() else FINE


def _ends(reason: str) -> Finding:
    return Finding(0.0, reason, ends=True)


def continued(known: SeenBody, now: SeenBody) -> SeenBody:
    """The known body after a view of it: what the view does not show stays as it was seen last."""
    hands, trunk = np.isfinite(now.hand_xyz).all(), np.asarray(np.isfinite(now.trunk_xyz).all(axis=1))
    mean_m = known.lengths_m + _NEW * (now.lengths_m - known.lengths_m)
    return SeenBody(
        person_id=known.person_id,
        hand_xyz=now.hand_xyz if hands else known.hand_xyz,
        other_xyz=now.other_xyz if hands else known.other_xyz,
        hand_ns=now.hand_ns if hands else known.hand_ns,
        trunk_xyz=np.where(trunk[:, None], now.trunk_xyz, known.trunk_xyz),
        trunk_ns=np.where(trunk, now.trunk_ns, known.trunk_ns),
        lengths_m=np.where(np.isfinite(mean_m), mean_m, np.where(np.isfinite(known.lengths_m), known.lengths_m, now.lengths_m)),
    )


def _length(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1))
