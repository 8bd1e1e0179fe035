"""The kinematic tree: which joints move how, and which keypoints hang where."""

from __future__ import annotations

from dataclasses import dataclass

from posefuse.core.skeleton import SIDES
from posefuse.kinematics.definitions import X, Y, Z

SLIDE, HINGE, BALL = 0, 1, 2
FREE = float("inf")


@dataclass(frozen=True, kw_only=True)
class Node:
    """One joint of the tree; a frame that moves relative to its parent's.

    Attributes:
        name: its name. parent: name of the node it is attached to, "" for the world.
        kind: SLIDE or HINGE along or about `axis`, or BALL.
        offset: name of the offset (3,) of its origin in its parent's frame; "" is zero.
        sd: radians or metres a human departs from zero (inf: no preference).
        slack: does not move of itself, only gives way: soft tissue, shoulder girdle.
        limits: (low, high) of a hinge in rad; of a ball: of its three ZXY angles.
    """

    name: str
    parent: str
    kind: int
    axis: int = 0
    offset: str = ""
    sd: float = FREE
    slack: bool = False
    limits: tuple[tuple[float, float], ...] = ()


def _side(side: str) -> tuple[Node, ...]:
    s, e, w = f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist"
    h, k, a = f"{side}_hip", f"{side}_knee", f"{side}_ankle"
    return (
        Node(name=f"{side}_girdle_x", parent="stretch", kind=SLIDE, axis=X, offset=s, sd=0.025, slack=True),
        Node(name=f"{side}_girdle_y", parent=f"{side}_girdle_x", kind=SLIDE, axis=Y, sd=0.025, slack=True),
        Node(name=s, parent=f"{side}_girdle_y", kind=BALL, sd=1.5),
        Node(name=f"{side}_carrying", parent=s, kind=HINGE, axis=X, offset=e, sd=0.07, slack=True),
        Node(name=e, parent=f"{side}_carrying", kind=HINGE, axis=Z, sd=1.2, limits=((-0.15, 2.7),)),
        Node(name=f"{side}_pronation", parent=e, kind=HINGE, axis=Y, offset=w, sd=1.0, limits=((-0.6, 3.3),)),
        Node(name=f"{side}_wrist_flexion", parent=f"{side}_pronation", kind=HINGE, axis=Z, sd=0.5, limits=((-1.4, 1.5),)),
        Node(name=f"{side}_hand", parent=f"{side}_wrist_flexion", kind=HINGE, axis=X, sd=0.3, limits=((-0.7, 0.7),)),
        Node(name=h, parent="pelvis", kind=BALL, offset=h, sd=0.8, limits=((-0.7, 2.3), (-0.9, 0.7), (-0.9, 0.9))),
        Node(name=f"{side}_varus", parent=h, kind=HINGE, axis=X, offset=k, sd=0.07, slack=True),
        Node(name=k, parent=f"{side}_varus", kind=HINGE, axis=Z, sd=1.0, limits=((-2.7, 0.15),)),
        Node(name=a, parent=k, kind=BALL, offset=a, sd=0.4, limits=((-1.1, 0.7), (-0.7, 0.7), (-0.8, 0.8))),
    )


NODES = (
    Node(name="x", parent="", kind=SLIDE, axis=X),
    Node(name="y", parent="x", kind=SLIDE, axis=Y),
    Node(name="z", parent="y", kind=SLIDE, axis=Z),
    Node(name="pelvis", parent="z", kind=BALL),
    Node(name="bend", parent="pelvis", kind=HINGE, axis=X, sd=0.4, limits=((-0.8, 0.8),)),
    Node(name="twist", parent="bend", kind=HINGE, axis=Y, sd=0.5, limits=((-1.2, 1.2),)),
    Node(name="stretch", parent="twist", kind=SLIDE, axis=Y, offset="neck", sd=0.03, slack=True),
    Node(name="head", parent="stretch", kind=BALL, offset="head", sd=0.6),
    *_side("left"),
    *_side("right"),
)

# the node each keypoint is fixed to; a limb joint sits at the node's own origin, the others at an estimated place
_ENDS = {"elbow": "carrying", "wrist": "pronation", "knee": "varus", "ankle": "ankle", "shoulder": "shoulder", "hip": "hip"}
_HEAD = ("nose", "head", *(f"{s}_{p}" for s in SIDES for p in ("eye", "eye_inner", "eye_outer", "ear", "mouth")))
AT_ORIGIN = {f"{side}_{point}": f"{side}_{node}" for side in SIDES for point, node in _ENDS.items()}
TEMPLATES = (
    dict.fromkeys(_HEAD, "head")
    | {f"{s}_{p}": f"{s}_hand" for s in SIDES for p in ("index", "pinky", "thumb")}
    | {f"{s}_{p}": f"{s}_ankle" for s in SIDES for p in ("heel", "big_toe", "small_toe", "foot_index")}
    | {"neck": "stretch", "mid_hip": "pelvis"}
)
# the segment whose frame a template point is constant in, and the limb node that carries that segment's rotation
_TURNED = (
    ("shoulder", "upper_arm"), ("elbow", "forearm"), ("hand", "hand"), ("hip", "thigh"), ("knee", "shank"), ("ankle", "foot"),
)  # fmt: skip
NODE_SEGMENT = {"pelvis": "pelvis", "stretch": "thorax", "head": "head"} | {
    f"{side}_{node}": f"{side}_{segment}" for side in SIDES for node, segment in _TURNED
}
