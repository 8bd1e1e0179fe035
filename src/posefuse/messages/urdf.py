"""A person as URDF: the human model of REP-155 with this person's lengths.

Links and joints are named as in the reference model of the package `human_description`, each with the person's id. A
`robot_state_publisher` with this text and the topic ``joint_states`` puts every link where it was seen.
"""

from __future__ import annotations

from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.skeleton import LIMB_ENDS

from .bodies import PARTS

_LIMIT = '<limit lower="-6.2832" upper="6.2832" effort="10" velocity="50"/>'
_RADIUS_M = 0.04


def _ends(*pairs: tuple[str, str]) -> Array:
    """(n, 2) places of the ends in `PARTS`."""
    return np.array([[PARTS.index(part) for part in pair] for pair in pairs])


# ends of the lengths of `Sizes`: between the middles of both sides, between the sides, and on each side
_TRUNK = _ends(("shoulder", "hip"), ("ear", "shoulder"))
_ACROSS = [PARTS.index("shoulder"), PARTS.index("hip")]
_LIMBS = _ends(*LIMB_ENDS.values())


class Sizes(NamedTuple):
    """Lengths of a person in metres.

    Attributes:
        torso: middle of the hips to the middle of the shoulders. head: from there up to the middle of the ears.
        shoulder, hip: half the distance of both. upper_arm, forearm, thigh, shank: between the joints.
    """

    torso: float
    head: float
    shoulder: float
    hip: float
    upper_arm: float
    forearm: float
    thigh: float
    shank: float

    def differs(self, other: Sizes, by_m: float) -> bool:
        """Whether any length is another by more than `by_m`."""
        return any(abs(mine - theirs) > by_m for mine, theirs in zip(self, other, strict=True))


def sizes_from_points(points: Array) -> Array:
    """(N, 8) lengths in the order of `Sizes` from keypoints (N, len(POINTS), 3); both sides' mean, NaN where not seen."""
    sides = points[:, : 2 * len(PARTS)].reshape(-1, len(PARTS), 2, 3)
    left, right = sides[:, :, 0], sides[:, :, 1]
    middle = (left + right) / 2
    trunk = middle[:, _TRUNK[:, 0]] - middle[:, _TRUNK[:, 1]]
    limbs = sides[:, _LIMBS[:, 0]] - sides[:, _LIMBS[:, 1]]
    across = left[:, _ACROSS] - right[:, _ACROSS]
    lengths = np.linalg.norm(np.concatenate([trunk, across, limbs[:, :, 0], limbs[:, :, 1]], axis=1), axis=-1)
    # a half of what is across, and the mean of both sides
    both = (lengths[:, 4:8] + lengths[:, 8:]) / 2
    return np.concatenate([lengths[:, :2], lengths[:, 2:4] / 2, both], axis=-1)


def urdf_text(body: str, sizes: Sizes) -> str:
    """The model of the body with id `body`, e.g. ``p3``."""
    s = sizes
    parts = [_link("body", body), _joint("waist", body, "body", "torso", (0, 0, s.torso), (0, 0, 1)), _link("torso", body)]
    up = (0.0, 0.0, s.torso + s.head)
    parts += _chain(body, "body", "head", up, (("r_head", (1, 0, 0)), ("y_head", (0, 0, 1)), ("p_head", (0, -1, 0))), 0.0)
    for side, sign in (("l", 1.0), ("r", -1.0)):
        turns = (
            (f"{side}_y_shoulder", (0, 0, -sign)),
            (f"{side}_p_shoulder", (sign, 0, 0)),
            (f"{side}_r_shoulder", (0, 0, sign)),
        )
        parts += _chain(body, "body", f"{side}_shoulder", (0, sign * s.shoulder, s.torso), turns, s.upper_arm)
        parts += _lower(body, f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist", s.upper_arm, s.forearm)
        turns = ((f"{side}_y_hip", (0, 0, -1)), (f"{side}_p_hip", (sign, 0, 0)), (f"{side}_r_hip", (0, -1, 0)))
        parts += _chain(body, "body", f"{side}_hip", (0, sign * s.hip, 0), turns, s.thigh)
        parts += _lower(body, f"{side}_hip", f"{side}_knee", f"{side}_ankle", s.thigh, s.shank)
    return f'<?xml version="1.0"?>\n<robot name={quoteattr(f"human_{body}")}>\n' + "\n".join(parts) + "\n</robot>\n"


def _chain(body: str, parent: str, link: str, xyz: tuple[float, ...], turns: Turns, length_m: float) -> list[str]:
    """Three turning joints at one place, and the link that they turn."""
    found, above = [], parent
    for i, (name, axis) in enumerate(turns):
        last = i == len(turns) - 1
        below = link if last else f"{name}_link"
        found += [
            _joint(name, body, above, below, xyz if i == 0 else (0, 0, 0), axis),
            _link(below, body, length_m if last else 0.0),
        ]
        above = below
    return found


def _lower(body: str, upper: str, lower: str, end: str, upper_m: float, lower_m: float) -> list[str]:
    """Elbow and wrist, or knee and ankle."""
    return [
        _joint(lower, body, upper, lower, (0, 0, -upper_m), (0, -1, 0)),
        _link(lower, body, lower_m),
        _joint(f"{end}_fixed", body, lower, end, (0, 0, -lower_m), None),
        _link(end, body),
    ]


Turns = tuple[tuple[str, tuple[float, float, float]], ...]


def _joint(name: str, body: str, parent: str, child: str, xyz: tuple[float, ...], axis: tuple[float, ...] | None) -> str:
    where = " ".join(f"{v:.4f}" for v in xyz)
    turning = f'<axis xyz="{" ".join(f"{v:g}" for v in axis)}"/>{_LIMIT}' if axis else ""
    return (
        f'<joint name="{name}_{body}" type="{"revolute" if axis else "fixed"}"><parent link="{parent}_{body}"/>'
        f'<child link="{child}_{body}"/><origin xyz="{where}" rpy="0 0 0"/>{turning}</joint>'
    )


def _link(name: str, body: str, length_m: float = 0.0) -> str:
    if not length_m:
        return f'<link name="{name}_{body}"/>'
    shape = f'<cylinder radius="{_RADIUS_M}" length="{length_m:.4f}"/>'
    middle = f'<origin xyz="0 0 {-length_m / 2:.4f}" rpy="0 0 0"/>'
    return f'<link name="{name}_{body}"><visual>{middle}<geometry>{shape}</geometry></visual></link>'
