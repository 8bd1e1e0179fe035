"""How far joint angles are from a reference, joint by joint and axis by axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import InputError, JointAngles
from posefuse.core.arrays import Array

_NEAREST_NS = 2_000_000


@dataclass(frozen=True, kw_only=True)
class AngleError:
    """One angle of one joint over a recording, all people together, degrees.

    Attributes:
        joint, angle: names.
        bias_deg: mean error; a constant offset between two definitions of a segment shows here.
        sd_deg: standard deviation of the error about its mean. rmse_deg: root mean square of the error.
        stated_deg: median of the standard deviation the estimate itself states.
        defined: share of time steps with an estimate.
    """

    joint: str
    angle: str
    bias_deg: float
    sd_deg: float
    rmse_deg: float
    stated_deg: float
    defined: float


def angle_errors(estimate: JointAngles, reference: JointAngles) -> list[AngleError]:
    """Errors of every angle both know by name, at the time steps of the estimate nearest to those of the reference.

    Raises:
        InputError: other people, no time step within 2 ms of one of the reference, or no angle in common.
    """
    if len(estimate.person_id) != len(reference.person_id):
        raise InputError(f"angles: expected {len(reference.person_id)} people as in the reference, got {len(estimate.person_id)}")
    at, back = _matched(estimate.t_ns, reference.t_ns)
    errors = []
    for q, joint in enumerate(estimate.joints):
        if joint not in reference.joints:
            continue
        r = reference.joints.index(joint)
        for a, angle in enumerate(estimate.angle_names[q]):
            if angle not in reference.angle_names[r]:
                continue
            b = reference.angle_names[r].index(angle)
            got, wanted = estimate.angle_rad[at, :, q, a], reference.angle_rad[back, :, r, b]
            errors.append(_error(joint, angle, got, wanted, estimate.sigma_rad[at, :, q, a]))
    if not errors:
        raise InputError(f"angles: no angle in common; the reference has {', '.join(reference.joints)}")
    return errors


def _matched(t_ns: Array, reference_ns: Array) -> tuple[Array, Array]:
    """Places in both of time steps that are the same."""
    place = np.clip(np.searchsorted(reference_ns, t_ns), 1, len(reference_ns) - 1)
    place -= np.abs(reference_ns[place - 1] - t_ns) < np.abs(reference_ns[place] - t_ns)
    same = np.flatnonzero(np.abs(reference_ns[place] - t_ns) <= _NEAREST_NS)
    if not len(same):
        raise InputError("angles: estimate and reference have no time step in common (within 2 ms)")
    return same, place[same]


def _error(joint: str, angle: str, got: Array, wanted: Array, sigma: Array) -> AngleError:
    error = np.degrees(np.angle(np.exp(1j * (got - wanted))))
    known = np.isfinite(error)
    if not known.any():
        nothing = float("nan")
        return AngleError(
            joint=joint, angle=angle, bias_deg=nothing, sd_deg=nothing, rmse_deg=nothing, stated_deg=nothing, defined=0.0
        )
    error, stated = error[known], np.degrees(sigma[known])
    return AngleError(
        joint=joint,
        angle=angle,
        bias_deg=float(error.mean()),
        sd_deg=float(error.std()),
        rmse_deg=float(np.sqrt((error**2).mean())),
        stated_deg=float(np.median(stated)),
        defined=float(known.mean()),
    )
