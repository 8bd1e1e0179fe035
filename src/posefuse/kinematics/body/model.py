"""The kinematic tree: which joints move how, and which keypoints hang where; and a person's own, estimated from a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from posefuse.core import InputError, PoseSequence, Skeleton
from posefuse.core.arrays import SIGMA_PER_MAD, Array
from posefuse.core.skeleton import LIMB_ENDS, SIDES
from posefuse.kinematics.definitions import SEGMENT_NAMES, X, Y, Z, landmark_pairs
from posefuse.kinematics.joints import joints_from_poses
from posefuse.kinematics.settings import BodySettings
from posefuse.kinematics.side_clues import landmarks

from .tree_kernels import BALL, HINGE, SLIDE, Tree

_FREE = float("inf")


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
    sd: float = _FREE
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
_AT_ORIGIN = {f"{side}_{point}": f"{side}_{node}" for side in SIDES for point, node in _ENDS.items()}
_TEMPLATES = (
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

# time steps in which what a skeleton is made of must have been seen
FEWEST_SEEN = 5


@dataclass(frozen=True)
class Length:
    """A segment length in metres.

    Attributes:
        value_m: the length. spread_m: robust standard deviation over time; a large one means soft tissue or bad keypoints.
        sigma_m: standard deviation of the value; NaN where it was not solved for.
    """

    value_m: float
    spread_m: float
    sigma_m: float = float("nan")


@dataclass(frozen=True, eq=False, kw_only=True)
class BodyModel:
    """One person's skeleton, ready to be fitted.

    Attributes:
        skeleton: names the keypoints.
        nodes: the joints of the tree that the keypoints can move.
        offset: (nodes, 3) origin of each in its parent's frame, metres.
        keypoint, keypoint_node, keypoint_local: (A,), (A,), (A, 3): keypoints of the tree, the node each is fixed to, where.
        lengths: named segment lengths.
        length_slopes: (nodes, S, 3) by how much each offset changes per metre of each segment that was solved for; S is 0 where
            none was. length_cov: (S, S) covariance of these.
    """

    skeleton: Skeleton
    nodes: tuple[Node, ...]
    offset: Array
    keypoint: Array
    keypoint_node: Array
    keypoint_local: Array
    lengths: dict[str, Length]
    length_slopes: Array
    length_cov: Array

    def same_tree(self, other: BodyModel) -> bool:
        """Whether both have the same joints and keypoints: only their places differ."""
        same_keypoints = self.keypoint is other.keypoint or np.array_equal(self.keypoint, other.keypoint)
        return self.nodes == other.nodes and same_keypoints

    def node(self, name: str) -> int:
        """Place of a node."""
        return [node.name for node in self.nodes].index(name)


def bodies_from_poses(sequence: PoseSequence) -> dict[int, BodyModel]:
    """Each person's skeleton, by person_id, from all the time steps they were seen.

    Lengths are medians over time, freed of the part that noise adds (a noisy distance is too long on average). What a
    detector calls a hip or shoulder lies at a constant offset from the joint centre; such offsets become part of the
    skeleton and cannot be distinguished from it.

    People whose hips and shoulders were seen in too few time steps are left out.

    Raises:
        InputError: that is so of everybody; left and right are swapped.
    """
    # the angles go at once: of an hour they take much memory
    rotation = joints_from_poses(sequence).world_from_segment.matrix()
    bodies = {
        person: body_from_frames(sequence.skeleton, sequence.xyz_world[:, n], sequence.cov_world[:, n], rotation[:, n])
        for n, person in enumerate(sequence.person_id.tolist())
    }
    known = {person: body for person, body in bodies.items() if body is not None}
    if bodies and not known:
        raise InputError(
            f"whole-body fit: expected both hips and both shoulders of a person in at least {FEWEST_SEEN} time steps; there are "
            f"{len(sequence)}, and no person has so many; `fit=none` takes joint angles from the 3D points as they are"
        )
    return known


def body_from_frames(skeleton: Skeleton, xyz: Array, cov: Array, rotation: Array) -> BodyModel | None:
    """One person's skeleton from keypoints (T, K, 3), (T, K, 3, 3) and segment frames (T, S, 3, 3); None if hardly ever seen."""
    points, variance = landmarks(xyz, skeleton), np.trace(cov, axis1=-2, axis2=-1) / 3
    noise_var = float(_median(variance.ravel())) if np.isfinite(variance).any() else 0.0
    frame = {name: rotation[:, SEGMENT_NAMES.index(name)] for name in SEGMENT_NAMES}
    lengths = _lengths(points, noise_var)
    if "pelvis" not in lengths or "trunk" not in lengths:
        return None
    offsets = _offsets(points, frame, lengths)
    nodes = _reachable(offsets)
    places = _attached(skeleton, xyz, frame, points, offsets, {node.name for node in nodes})
    nodes = _needed(nodes, {node for node, _ in places.values()})
    names = [node.name for node in nodes]
    offset = np.array([offsets[node.offset] if node.offset else np.zeros(3) for node in nodes])
    at = np.array([names.index(node) for node, _ in places.values()], np.intp)
    local = np.array([place for _, place in places.values()]).reshape(-1, 3)
    return BodyModel(
        skeleton=skeleton,
        nodes=nodes,
        offset=offset,
        keypoint=np.array(list(places), np.intp),
        keypoint_node=at,
        keypoint_local=local,
        lengths=lengths,
        length_slopes=np.zeros((len(nodes), 0, 3)),
        length_cov=np.zeros((0, 0)),
    )


def _median(values: Array) -> Array:
    """As np.nanmedian over the first axis, which takes many times as long for the few time steps of a live session."""
    # NaN come last
    ordered = np.sort(values, axis=0)
    last = np.maximum((~np.isnan(values)).sum(axis=0, keepdims=True) - 1, 0)
    lower, upper = (np.take_along_axis(ordered, at, axis=0)[0] for at in (last // 2, (last + 1) // 2))
    return np.asarray((lower + upper) / 2)


def segment_spans(points: Mapping[str, Array]) -> dict[str, Array]:
    """(..., 3) from one end to the other of every segment that has a length, by the names of `BodyModel.lengths`."""
    spans = {"pelvis": points["right_hip"] - points["left_hip"], "shoulders": points["right_shoulder"] - points["left_shoulder"]}
    spans["trunk"] = (points["left_shoulder"] + points["right_shoulder"] - points["left_hip"] - points["right_hip"]) / 2
    for side in SIDES:
        for bone, (upper, lower) in LIMB_ENDS.items():
            spans[f"{side}_{bone}"] = points[f"{side}_{upper}"] - points[f"{side}_{lower}"]
    return spans


def _lengths(points: dict[str, Array], noise_var: float) -> dict[str, Length]:
    """Of every segment that was seen; left and right share one."""
    spans = segment_spans(points)
    distance = np.linalg.norm(np.stack(list(spans.values()), axis=1), axis=-1)
    seen = np.isfinite(distance).sum(axis=0) >= FEWEST_SEEN
    lengths = {}
    middles = _median(distance)
    spreads = SIGMA_PER_MAD * _median(np.abs(distance - middles))
    for name, known, middle, spread in zip(spans, seen, middles, spreads, strict=True):
        if not known:
            continue
        ends_var = noise_var * (1.0 if name == "trunk" else 2.0)
        # two directions across the bone add their variance to the squared length
        lengths[name] = Length(float(np.sqrt(max(middle**2 - 2 * ends_var, (0.5 * middle) ** 2))), float(spread))
    for bone in LIMB_ENDS:
        left, right = (f"{side}_{bone}" for side in SIDES)
        if left in lengths and right in lengths:
            shared_m = (lengths[left].value_m + lengths[right].value_m) / 2
            lengths |= {name: replace(lengths[name], value_m=shared_m) for name in (left, right)}
    return lengths


def _offsets(points: dict[str, Array], frame: dict[str, Array], lengths: dict[str, Length]) -> dict[str, Array]:
    """Origins of the nodes in their parents' frames; what cannot be determined is left out."""
    out = {"neck": np.array([0, lengths["trunk"].value_m, 0])}
    for side, sign in (("left", -0.5), ("right", 0.5)):
        out[f"{side}_hip"] = np.array([0, 0, sign * lengths["pelvis"].value_m])
        out[f"{side}_shoulder"] = np.array([0, 0, sign * lengths["shoulders"].value_m])
        for bone, (_, lower) in LIMB_ENDS.items():
            if f"{side}_{bone}" in lengths:
                out[f"{side}_{lower}"] = np.array([0, -lengths[f"{side}_{bone}"].value_m, 0])
    ears = (points["left_ear"] + points["right_ear"]) / 2
    neck = (points["left_shoulder"] + points["right_shoulder"]) / 2
    in_thorax = np.einsum("tij,ti->tj", frame["thorax"], ears - neck)
    relative = np.einsum("tij,tik->tjk", frame["thorax"], frame["head"])
    seen = np.isfinite(in_thorax).all(axis=-1) & np.isfinite(relative).all(axis=(-1, -2))
    if seen.sum() >= FEWEST_SEEN:
        # heads nod about the middle between neck and ears: a centre fitted to each person is 0.4 mm better for wild nods only
        half = np.median(in_thorax[seen], axis=0) / 2
        out["head"], out["ears"] = half, np.einsum("tji,j->ti", relative[seen], half).mean(axis=0)
    return out


def _reachable(offsets: dict[str, Array]) -> tuple[Node, ...]:
    """The nodes with a known position whose parents' positions are known, too."""
    kept: list[Node] = []
    names = {""}
    for node in NODES:
        if node.parent in names and (not node.offset or node.offset in offsets):
            kept.append(node)
            names.add(node.name)
    return tuple(kept)


def _needed(nodes: tuple[Node, ...], used: set[str]) -> tuple[Node, ...]:
    """Without the branches that carry no keypoint."""
    wanted = set(used)
    for node in reversed(nodes):
        if node.name in wanted:
            wanted.add(node.parent)
    return tuple(node for node in nodes if node.name in wanted)


def _attached(
    skeleton: Skeleton,
    xyz: Array,
    frame: dict[str, Array],
    points: dict[str, Array],
    offsets: dict[str, Array],
    names: set[str],
) -> dict[int, tuple[str, Array]]:
    """Node and local place (3,) of each keypoint the tree carries."""
    keypoints = skeleton.keypoints
    at_origin = {index: _AT_ORIGIN[name] for index, name in enumerate(keypoints) if _AT_ORIGIN.get(name) in names}
    templates = {index: _TEMPLATES[name] for index, name in enumerate(keypoints) if _TEMPLATES.get(name) in names}
    places = {index: (node, np.zeros(3)) for index, node in at_origin.items()}
    if templates:
        origins, seen = _template_origins(points), np.empty((len(xyz), len(templates), 3))
        for at, (index, node) in enumerate(templates.items()):
            seen[:, at] = np.einsum("tij,ti->tj", frame[NODE_SEGMENT[node]], xyz[:, index] - origins[node])
        enough = np.isfinite(seen).all(axis=-1).sum(axis=0) >= FEWEST_SEEN
        for (index, node), known, place in zip(templates.items(), enough, _median(seen), strict=True):
            if known:
                places[index] = node, place + (offsets["ears"] if node == "head" else 0.0)
    return dict(sorted(places.items()))


def _template_origins(points: dict[str, Array]) -> dict[str, Array]:
    def middle(name: str) -> Array:
        return (points[f"left_{name}"] + points[f"right_{name}"]) / 2

    origins = {"head": middle("ear"), "stretch": middle("shoulder"), "pelvis": middle("hip")}
    for side in SIDES:
        origins |= {f"{side}_hand": points[f"{side}_wrist"], f"{side}_ankle": points[f"{side}_ankle"]}
    return origins


def landmark_rows(body: BodyModel) -> Array:
    """(P, 2) rows of `body.keypoint` whose mean is each landmark; -1 where the tree does not carry it."""
    row = {int(k): i for i, k in enumerate(body.keypoint)}
    pairs = landmark_pairs(body.skeleton)
    rows = np.array([[row.get(int(a), -1), row.get(int(b), -1)] for a, b in pairs])
    rows[(rows < 0).any(axis=1)] = -1
    return rows


# white acceleration of the pelvis, square root of its spectral density, as `turn_accel_rad_s15` of the joints
_MOVE_ACCEL_M_S15 = 1.5
HABIT_S = 1.0  # a preference counts as one measurement in this time
SLACK_S = 0.5


def tree_from_body(body: BodyModel, settings: BodySettings) -> Tree:
    """A body as the kernels want it; limits and constants of motion from the settings."""
    nodes = body.nodes
    names = [node.name for node in nodes]
    dof = np.concatenate([[0], np.cumsum([3 if node.kind == BALL else 1 for node in nodes])])
    slack_var, accel = np.zeros(dof[-1]), np.full(dof[-1], settings.turn_accel_rad_s15)
    for n, node in enumerate(nodes):
        if node.slack:
            slack_var[dof[n]] = node.sd**2
        elif node.kind == SLIDE:
            accel[dof[n]] = _MOVE_ACCEL_M_S15
    return Tree(
        parent=np.array([names.index(node.parent) if node.parent else -1 for node in nodes]),
        kind=np.array([node.kind for node in nodes]),
        axis=np.array([node.axis for node in nodes]),
        offset=np.ascontiguousarray(body.offset),
        dof=dof,
        limits=np.array([_limits(node, settings.joint_limits) for node in nodes]),
        mirrored=np.array([node.name.startswith("left_") for node in nodes]),
        node=body.keypoint_node,
        local=np.ascontiguousarray(body.keypoint_local),
        preferred_sd=np.array([np.inf if node.slack else node.sd for node in nodes]),
        slack_var=slack_var,
        accel=accel,
    )


def _limits(node: Node, wanted: bool) -> Array:
    """(3, 2) low and high; (1, 0) where there is none. A left hinge about X or Y turns the other way."""
    out = np.tile([1.0, 0.0], (3, 1))
    if wanted and node.limits:
        out[: len(node.limits)] = node.limits
        if node.kind != BALL and node.axis != 2 and node.name.startswith("left_"):
            out[0] = -out[0, ::-1]
    return out
