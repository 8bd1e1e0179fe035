"""Room, light and occluders of a scene, and which points a camera sees.

A joint lies inside the body, so the first surface on the line of sight is nearly always before it. A joint counts as
hidden when that surface is further before it than the flesh around the joint is thick (`FLESH_M`): then it belongs to
another limb, another person or a thing. Two ways to find the surface: the depth of the rendered image, which is
exact, and, without rendering, `hidden_by_shapes`: boxes exactly, people as capsules between their keypoints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from pydantic import Field

from posefuse.core import SE3, ConfigError
from posefuse.core.arrays import Array, freeze_fields
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.foundation.settings import settings

Point = tuple[float, float, float]
Share = Annotated[float, Ge(0), Le(1)]
Colour = tuple[Share, Share, Share]
_TRIES = 1000
# least and greatest edge of a box at random
_CLUTTER_M = (0.2, 0.6)


@settings
class RoomSettings:
    """Floor, walls and light.

    Attributes:
        size_m: (x, y) of the floor about the origin; None makes it 1 m larger than what the cameras enclose.
        height_m: of the walls.
        floor: ``wood``, ``concrete``, ``tiles`` or ``plain``.
        walls: ``office`` (panels, windows, posters), ``plain`` or ``none`` (sky).
        brightness: 1 is a well lit room.
        shadows: whether the main light casts them.
    """

    size_m: tuple[Annotated[float, Gt(0)], Annotated[float, Gt(0)]] | None = None
    height_m: Annotated[float, Gt(0)] = 3.6
    floor: Literal["wood", "concrete", "tiles", "plain"] = "wood"
    walls: Literal["office", "plain", "none"] = "office"
    brightness: Annotated[float, Gt(0), Le(2)] = 1.0
    shadows: bool = True


@settings
class BoxOccluder:
    """A box that hides what is behind it.

    Attributes:
        position_m: its centre. size_m: its edges. yaw_deg: turned about the vertical.
        colour: red, green, blue in [0, 1].
    """

    kind: Literal["box"]
    position_m: Point
    size_m: tuple[Annotated[float, Gt(0)], Annotated[float, Gt(0)], Annotated[float, Gt(0)]]
    yaw_deg: float = 0.0
    colour: Colour = (0.55, 0.45, 0.35)


@settings
class WallOccluder:
    """A free-standing wall between two points of the floor."""

    kind: Literal["wall"]
    from_m: tuple[float, float]
    to_m: tuple[float, float]
    height_m: Annotated[float, Gt(0)] = 1.2
    thickness_m: Annotated[float, Gt(0)] = 0.05
    colour: Colour = (0.75, 0.75, 0.72)


@settings
class ClutterOccluder:
    """Boxes at random on the floor.

    Attributes:
        count: how many. area_m: (x, y) of the rectangle about the origin they stand in.
        keep_clear_m: radius about the origin that stays empty.
        most_height_m: greatest height; the other edges are 0.2 to 0.6 m.
        seed: None takes the scene's.
    """

    kind: Literal["clutter"]
    count: Annotated[int, Ge(1)] = 6
    area_m: tuple[Annotated[float, Gt(0)], Annotated[float, Gt(0)]] = (6.0, 6.0)
    keep_clear_m: Annotated[float, Ge(0)] = 1.5
    most_height_m: Annotated[float, Gt(0)] = 1.2
    seed: int | None = None


OccluderSettings = Annotated[BoxOccluder | WallOccluder | ClutterOccluder, Field(discriminator="kind")]


@dataclass(frozen=True, eq=False)
class Box:
    """A solid box that stands still.

    Attributes:
        half_m: (3,) half of its edges. world_from_box: its pose. colour: (3,) in [0, 1].
    """

    half_m: Array
    world_from_box: SE3
    colour: Colour

    def __post_init__(self) -> None:
        freeze_fields(self, {"half_m": np.float64})

    def between(self, eye_world: Array, xyz_world: Array) -> Array:
        """(...) whether the straight line from the eye (3,) to points (..., 3) meets the box (slab method)."""
        box_from_world = self.world_from_box.inverse()
        start = box_from_world @ np.asarray(eye_world)
        way = box_from_world @ np.asarray(xyz_world) - start
        with np.errstate(divide="ignore", invalid="ignore"):
            near = (-self.half_m - start) / way
            far = (self.half_m - start) / way
        enter = np.fmax.reduce(np.minimum(near, far), axis=-1)
        leave = np.fmin.reduce(np.maximum(near, far), axis=-1)
        outside = ((way == 0) & (np.abs(start) > self.half_m)).any(axis=-1)
        return np.asarray((enter <= leave) & (leave >= 0) & (enter <= 1) & ~outside)


def boxes_of(occluders: tuple[BoxOccluder | WallOccluder | ClutterOccluder, ...], seed: int) -> tuple[Box, ...]:
    """Every occluder as boxes, random ones drawn from the seed."""
    boxes: list[Box] = []
    for i, occluder in enumerate(occluders):
        if isinstance(occluder, BoxOccluder):
            boxes.append(_box(occluder.position_m, occluder.size_m, np.deg2rad(occluder.yaw_deg), occluder.colour))
        elif isinstance(occluder, WallOccluder):
            boxes.append(_wall(occluder))
        else:
            boxes.extend(_clutter(occluder, [seed if occluder.seed is None else occluder.seed, 21, i]))
    return tuple(boxes)


def _box(centre_m: Sequence[float], size_m: Sequence[float] | Array, yaw_rad: float, colour: Colour) -> Box:
    return Box(np.array(size_m) / 2, SE3.from_rotvec([0.0, 0.0, float(yaw_rad)], np.array(centre_m)), colour)


def _wall(wall: WallOccluder) -> Box:
    (x0, y0), (x1, y1) = wall.from_m, wall.to_m
    length = float(np.hypot(x1 - x0, y1 - y0))
    centre = ((x0 + x1) / 2, (y0 + y1) / 2, wall.height_m / 2)
    return _box(
        centre, (max(length, wall.thickness_m), wall.thickness_m, wall.height_m), np.arctan2(y1 - y0, x1 - x0), wall.colour
    )


def _clutter(clutter: ClutterOccluder, seed: list[int]) -> list[Box]:
    rng = np.random.default_rng(seed)
    boxes: list[Box] = []
    for _ in range(_TRIES):
        if len(boxes) == clutter.count:
            break
        size = rng.uniform(*_CLUTTER_M, 3)
        size[2] = rng.uniform(_CLUTTER_M[0], max(_CLUTTER_M[0], clutter.most_height_m))
        spot = rng.uniform(-0.5, 0.5, 2) * clutter.area_m
        yaw, colour = rng.uniform(0, np.pi), rng.uniform(0.2, 0.8, 3)
        if np.hypot(*spot) - np.hypot(size[0], size[1]) / 2 >= clutter.keep_clear_m:
            boxes.append(_box([*spot, size[2] / 2], size, yaw, (float(colour[0]), float(colour[1]), float(colour[2]))))
    if len(boxes) < clutter.count:
        raise ConfigError(
            f"occluders: clutter: only {len(boxes)} of {clutter.count} boxes fit into area_m {clutter.area_m} outside "
            f"keep_clear_m {clutter.keep_clear_m}; make the area larger or the clear circle smaller"
        )
    return boxes


_FLESH_OF_JOINT_M = {
    "nose": 0.05, "eye": 0.05, "ear": 0.06, "shoulder": 0.12, "elbow": 0.08, "wrist": 0.07, "hip": 0.17, "knee": 0.10,
    "ankle": 0.08, "big_toe": 0.06, "small_toe": 0.06, "heel": 0.07,
}  # fmt: skip
FLESH_M = np.array([_FLESH_OF_JOINT_M[name.removeprefix("left_").removeprefix("right_")] for name in ANATOMICAL23.keypoints])

# ends of each capsule (the mean of the named keypoints) and its radius, for an adult
_SIDED_CAPSULES = (
    (("shoulder",), ("elbow",), 0.050),
    (("elbow",), ("wrist",), 0.038),
    (("hip",), ("knee",), 0.075),
    (("knee",), ("ankle",), 0.052),
    (("heel",), ("big_toe",), 0.025),
    (("shoulder",), ("hip",), 0.085),
)
_MIDDLE_CAPSULES = (
    (("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"), 0.115),
    (("left_shoulder", "right_shoulder"), ("left_ear", "right_ear"), 0.060),
    (("left_ear", "right_ear"), ("left_ear", "right_ear"), 0.085),
)
_CAPSULES = (
    tuple(
        (tuple(f"{side}_{a}" for a in start), tuple(f"{side}_{b}" for b in end), radius)
        for side in ("left", "right")
        for start, end, radius in _SIDED_CAPSULES
    )
    + _MIDDLE_CAPSULES
)
_TINY = 1e-12


def hidden_by_shapes(eye_world: Array, xyz_world: Array, flesh_m: Array, boxes: tuple[Box, ...], people: Array) -> Array:
    """(F, Q) whether points (F, Q, 3) are hidden from the eye (3,) by boxes or by people (F, N, 23, 3) as capsules.

    A surface less than `flesh_m` (Q,) before a point does not hide it.
    """
    hidden = np.zeros(xyz_world.shape[:-1], bool)
    for box in boxes:
        hidden |= box.between(eye_world, xyz_world)
    way = xyz_world - eye_world
    length = np.linalg.norm(way, axis=-1)
    free_m = length - flesh_m
    direction = way / np.maximum(length, _TINY)[..., None]
    for person in range(people.shape[1]):
        for start, end, radius in _CAPSULES:
            ends = [people[:, person, ANATOMICAL23.indices(names)].mean(axis=1) for names in (start, end)]
            hidden |= _enters_at(eye_world, direction, ends[0][:, None], ends[1][:, None], radius) < free_m
    return hidden


def _enters_at(eye: Array, direction: Array, start: Array, end: Array, radius: float) -> Array:
    """Distance from the eye at which unit directions (F, Q, 3) enter a capsule, infinity where they pass it."""
    axis = end - start
    offset = eye - start
    along_axis = (direction * axis).sum(-1)
    axis_square = np.maximum((axis * axis).sum(-1), _TINY)
    offset_axis, offset_ray = (offset * axis).sum(-1), (offset * direction).sum(-1)
    # nearest points of line and axis; the axis ends at its ends
    below = np.maximum(axis_square - along_axis**2, _TINY)
    share = np.clip((offset_axis - along_axis * offset_ray) / below, 0, 1)
    nearest = start + share[..., None] * axis
    to_nearest = nearest - eye
    at = (to_nearest * direction).sum(-1)
    miss_square = (to_nearest**2).sum(-1) - at**2
    depth = np.sqrt(np.maximum(radius**2 - miss_square, 0))
    return np.where((miss_square < radius**2) & (at > 0), at - depth, np.inf)
