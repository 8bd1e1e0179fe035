"""What is left open about a body, decided: by a seed or by the average; and which vertex wears what."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from posefuse.core.arrays import Array

from .mesh import RestMesh
from .settings import BodyShapeSettings

GROUPS = ("shirt", "trousers", "shoes", "skin", "hair")
_DEFAULT = {"shirt": "#b22626", "trousers": "#1a2659", "shoes": "#0d0d0d", "skin": "#d9a68c", "hair": "#26190d"}
_PALETTE = {
    "shirt": ("#b22626", "#2a6f4e", "#e0dfd5", "#30475e", "#c98a1b", "#6a4c93", "#3a86c8", "#222222"),
    "trousers": ("#1a2659", "#2b2b2b", "#5b4636", "#6b705c", "#3d405b", "#8d99ae"),
    "shoes": ("#0d0d0d", "#e8e8e8", "#5e3023", "#22333b"),
    "skin": ("#f0c8a8", "#d9a68c", "#c68e6a", "#a56b46", "#7b4a2d", "#4f2f1e"),
    "hair": ("#26190d", "#0f0c0a", "#6b4423", "#a67c45", "#8a8a8a", "#5a1f10"),
}
_STATURE_M = {"female": (1.63, 0.065), "male": (1.77, 0.072)}
_LEGS = ("upperleg", "lowerleg", "pelvis", "root")
_FEET = ("foot", "toe")
_TORSO = ("spine", "clavicle", "shoulder", "upperarm")


def completed_shape(settings: BodyShapeSettings) -> BodyShapeSettings:
    """The same settings with nothing left open but the weight; the same seed always decides the same."""
    drawn = _average() if settings.random_seed is None else _drawn(settings.random_seed)
    given = {k: v for k in drawn if (v := getattr(settings, k, None)) is not None}
    decided = drawn | given
    if "height_m" not in given:
        decided["height_m"] = _stature(decided["sex"], decided["age_years"], decided.pop("stature_sigmas"))
    decided.pop("stature_sigmas", None)
    return replace(settings, **decided)


def _average() -> dict[str, Any]:
    return {"sex": "male", "age_years": 30.0, "height_m": None, "muscle": 0.5, "stature_sigmas": 0.0} | _DEFAULT


def _drawn(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    shape = {
        "sex": ("female", "male")[rng.integers(2)],
        "age_years": float(rng.uniform(20, 70)),
        "height_m": None,
        "muscle": float(rng.uniform(0.3, 0.8)),
        "stature_sigmas": float(np.clip(rng.standard_normal(), -2, 2)),
    }
    return shape | {group: colours[rng.integers(len(colours))] for group, colours in _PALETTE.items()}


def _stature(sex: str | float, age_years: float, sigmas: float) -> float:
    masculine = {"female": 0.0, "male": 1.0}[sex] if isinstance(sex, str) else sex
    mean, sd = (np.interp(masculine, (0, 1), ends) for ends in zip(*_STATURE_M.values(), strict=True))
    grown = np.interp(age_years, (5, 18), (0.63, 1.0))
    return float((mean + sigmas * sd) * grown)


def colour_groups(mesh: RestMesh, settings: BodyShapeSettings) -> tuple[Array, Array]:
    """The group (V,) in `GROUPS` each vertex wears, and the colour (G, 3) of each group in [0, 1].

    A vertex wears what its strongest bone wears; the top and back of the head is hair.
    """
    strongest = mesh.bone_index[np.arange(len(mesh.vertices)), mesh.bone_weight.argmax(axis=1)]
    names = np.array(mesh.bone_names)[strongest]
    group = np.full(len(names), GROUPS.index("skin"))
    for wearers, wears in ((_TORSO, "shirt"), (_LEGS, "trousers"), (_FEET, "shoes")):
        group[np.char.startswith(names[:, None], np.array(wearers)).any(axis=1)] = GROUPS.index(wears)
    # the lowest spine bone moves the crotch as well
    below_waist = mesh.vertices[:, 2] < mesh.world_from_bone[mesh.bone_names.index("spine04"), 2, 3]
    group[below_waist & np.char.startswith(names, "spine")] = GROUPS.index("trousers")
    head = names == "head"
    centre = mesh.vertices[head].mean(axis=0)
    size = np.ptp(mesh.vertices[head][:, 2]) / 0.26
    x, z = mesh.vertices[:, 0] - centre[0], mesh.vertices[:, 2] - centre[2]
    hair = head & ((z > 0.05 * size) | ((x < -0.02 * size) & (z > -0.04 * size)))
    group[hair] = GROUPS.index("hair")
    rgb = [[int(getattr(settings, g)[i : i + 2], 16) / 255 for i in (1, 3, 5)] for g in GROUPS]
    return group, np.array(rgb)
