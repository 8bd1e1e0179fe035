"""Distance between a robot and the body of the tracked operator, with what is not known of the body counted as nearer.

The idea is that of speed and separation monitoring (ISO/TS 15066, ISO 13855); a camera system without a safety rating cannot
claim either. A keypoint is somewhere in a ball: about where it was measured last, with a radius of its stated standard deviations
and of how far a limb moves since then; or about another keypoint, with a radius larger by the bones between the two. The smallest
ball counts, so that a limb out of sight is a ball of its length about the last joint in sight, for however long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from posefuse.core.arrays import Array

from .hands import BODY, BONES, TRUNK
from .settings import LIMB_RADIUS_M, SeparationSettings
from .values import OperatorView

_START = np.array([BODY.index(a) for a, _ in BONES])
_END = np.array([BODY.index(b) for _, b in BONES])


def _farthest() -> Array:
    """(K, K) greatest distance between any two keypoints, m: along the bones between them."""
    apart = np.full((len(BODY), len(BODY)), np.inf)
    np.fill_diagonal(apart, 0.0)
    apart[_START, _END] = apart[_END, _START] = list(BONES.values())
    for k in range(len(BODY)):
        apart = np.minimum(apart, apart[:, k, None] + apart[k])
    return apart


_APART_M = _farthest()
# of the range in which the speed falls
_LEAST_M = 1e-9


@dataclass(frozen=True, eq=False, kw_only=True)
class OperatorBody:
    """Where each keypoint of the operator was seen last.

    Attributes:
        person_id: of the operator. xyz_world: (K, 3); NaN: never. sigma_m: (K,). seen_ns: (K,) when.
    """

    person_id: int
    xyz_world: Array
    sigma_m: Array
    seen_ns: Array

    @staticmethod
    def unknown() -> OperatorBody:
        """No person was seen."""
        k = len(BODY)
        return OperatorBody(person_id=-1, xyz_world=np.full((k, 3), np.nan), sigma_m=np.zeros(k), seen_ns=np.zeros(k, np.int64))


def remembered(body: OperatorBody, view: OperatorView) -> OperatorBody:
    """The body after one more view: what it measures is renewed, the rest stays where it was seen last."""
    if view.person_id < 0:
        return body
    if body.person_id != view.person_id:
        body = OperatorBody.unknown()
    sure = np.isfinite(view.body_sigma_m) & (view.body_sigma_m >= 0)
    new = view.body_measured & np.isfinite(view.body_xyz_world).all(axis=1) & sure
    return OperatorBody(
        person_id=view.person_id,
        xyz_world=np.where(new[:, None], view.body_xyz_world, body.xyz_world),
        sigma_m=np.where(new, view.body_sigma_m, body.sigma_m),
        seen_ns=np.where(new, min(view.measured_ns, view.t_ns), body.seen_ns),
    )


class Limbs(NamedTuple):
    """Capsules: (B, 3) one end, (B, 3) the other, (B,) radius, m."""

    start: Array
    end: Array
    radius: Array


def limbs_of(body: OperatorBody, now_ns: int, settings: SeparationSettings) -> Limbs | None:
    """The operator's limbs, thicker by what is not known of them; None where a part of the trunk was never seen."""
    seen = np.asarray(np.isfinite(body.xyz_world).all(axis=1))
    if not seen[TRUNK].all():
        return None
    # a measurement from the future is as little known as one from the past
    age_s = np.abs(now_ns - body.seen_ns) / 1e9
    own = np.where(seen, settings.sigmas * body.sigma_m + settings.approach_mps * age_s, np.inf)
    balls = own[:, None] + _APART_M
    centre, unknown = body.xyz_world[balls.argmin(axis=0)], balls.min(axis=0)
    return Limbs(
        start=centre[_START],
        end=centre[_END],
        radius=LIMB_RADIUS_M + np.maximum(unknown[_START], unknown[_END]),
    )


def separation_m(body: OperatorBody, spheres_world: Array, now_ns: int, settings: SeparationSettings) -> float:
    """Least distance of the robot's spheres (M, 4) and the operator's limbs; NaN where a part of the trunk was never seen."""
    limbs = limbs_of(body, now_ns, settings)
    if limbs is None or not len(spheres_world) or not np.isfinite(spheres_world).all():
        return math.nan
    apart = distances_to_segments(spheres_world[:, :3], limbs.start, limbs.end)
    return float((apart - limbs.radius - spheres_world[:, 3:]).min())


def distances_to_segments(points: Array, start: Array, end: Array) -> Array:
    """(M, B) distances of points (M, 3) to segments between (B, 3) and (B, 3)."""
    along = end - start
    length2 = np.maximum((along * along).sum(axis=1), 1e-12)
    share = np.clip((points @ along.T - (start * along).sum(axis=1)) / length2, 0.0, 1.0)
    nearest = start[None] + share[..., None] * along[None]
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=-1))


def speed_share(distance_m: float, settings: SeparationSettings) -> float:
    """Share of the speed limit at a distance: 1 from `slow_m` on, 0 up to `stop_m` and where it is not known."""
    if not distance_m > settings.stop_m:
        return 0.0
    return min(1.0, (distance_m - settings.stop_m) / max(settings.slow_m - settings.stop_m, _LEAST_M))
