"""The kinematic tree: which joints move how, and which keypoints hang where."""

from __future__ import annotations

from dataclasses import dataclass

from posefuse.kinematics.definitions import X, Y, Z

SLIDE, HINGE, BALL = 0, 1, 2
FREE = float("inf")


@dataclass(frozen=True)
class Node:
    """One joint of the tree; a frame that moves relative to its parent's.

    Attributes:
        name: its name. parent: name of the node it hangs on, "" for the world.
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
        Node(f"{side}_girdle_x", "stretch", SLIDE, X, s, 0.025, True),
        Node(f"{side}_girdle_y", f"{side}_girdle_x", SLIDE, Y, "", 0.025, True),
        Node(s, f"{side}_girdle_y", BALL, sd=1.5),
        Node(f"{side}_carrying", s, HINGE, X, e, 0.07, True),
        Node(e, f"{side}_carrying", HINGE, Z, sd=1.2, limits=((-0.15, 2.7),)),
        Node(f"{side}_pronation", e, HINGE, Y, w, 1.0, limits=((-0.6, 3.3),)),
        Node(f"{side}_wrist_flexion", f"{side}_pronation", HINGE, Z, "", 0.5, limits=((-1.4, 1.5),)),
        Node(f"{side}_hand", f"{side}_wrist_flexion", HINGE, X, "", 0.3, limits=((-0.7, 0.7),)),
        Node(h, "pelvis", BALL, offset=h, sd=0.8, limits=((-0.7, 2.3), (-0.9, 0.7), (-0.9, 0.9))),
        Node(f"{side}_varus", h, HINGE, X, k, 0.07, True),
        Node(k, f"{side}_varus", HINGE, Z, sd=1.0, limits=((-2.7, 0.15),)),
        Node(a, k, BALL, offset=a, sd=0.4, limits=((-1.1, 0.7), (-0.7, 0.7), (-0.8, 0.8))),
    )


NODES = (
    Node("x", "", SLIDE, X),
    Node("y", "x", SLIDE, Y),
    Node("z", "y", SLIDE, Z),
    Node("pelvis", "z", BALL),
    Node("bend", "pelvis", HINGE, X, "", 0.4, limits=((-0.8, 0.8),)),
    Node("twist", "bend", HINGE, Y, "", 0.5, limits=((-1.2, 1.2),)),
    Node("stretch", "twist", SLIDE, Y, "neck", 0.03, True),
    Node("head", "stretch", BALL, offset="head", sd=0.6),
    *_side("left"),
    *_side("right"),
)

# the node each keypoint is fixed to; a limb joint sits at the node's own origin, the others at an estimated place
_ENDS = {"elbow": "carrying", "wrist": "pronation", "knee": "varus", "ankle": "ankle", "shoulder": "shoulder", "hip": "hip"}
_HEAD = ("nose", "head", *(f"{s}_{p}" for s in ("left", "right") for p in ("eye", "eye_inner", "eye_outer", "ear", "mouth")))
AT_ORIGIN = {f"{side}_{point}": f"{side}_{node}" for side in ("left", "right") for point, node in _ENDS.items()}
TEMPLATES = (
    dict.fromkeys(_HEAD, "head")
    | {f"{s}_{p}": f"{s}_hand" for s in ("left", "right") for p in ("index", "pinky", "thumb")}
    | {f"{s}_{p}": f"{s}_ankle" for s in ("left", "right") for p in ("heel", "big_toe", "small_toe", "foot_index")}
    | {"neck": "stretch", "mid_hip": "pelvis"}
)
# the segment whose frame a template point is constant in, and the limb node that carries that segment's rotation
_TURNED = (
    ("shoulder", "upper_arm"), ("elbow", "forearm"), ("hand", "hand"), ("hip", "thigh"), ("knee", "shank"), ("ankle", "foot"),
)  # fmt: skip
NODE_SEGMENT = {"pelvis": "pelvis", "stretch": "thorax", "head": "head"} | {
    f"{side}_{node}": f"{side}_{segment}" for side in ("left", "right") for node, segment in _TURNED
}
