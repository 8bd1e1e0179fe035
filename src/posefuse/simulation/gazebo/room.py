"""Floor and walls as textured meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from posefuse.core import SE3
from posefuse.core.arrays import Array
from posefuse.formats.collada import Mesh, Surface, write_collada
from posefuse.simulation.render import textures
from posefuse.simulation.surroundings import RoomSettings

from .world import StillModel

_UP = np.array([0.0, 0.0, 1.0])


def room_models(room: RoomSettings, size_m: tuple[float, float], seed: int, folder: Path, beside_world: str) -> list[StillModel]:
    """Write floor and walls into `folder`, which the world file calls `beside_world`; the models that show them."""
    rng = np.random.default_rng([seed, 32])
    pictures = {"floor": (textures.floor_picture(room.floor, rng), _floor(size_m))}
    if room.walls != "none":
        for i, (corner, along) in enumerate(_walls(size_m)):
            picture = textures.wall_picture(room.walls, float(np.linalg.norm(along)), room.height_m, rng)
            pictures[f"wall{i}"] = picture, _rectangle(corner, along, room.height_m * _UP)
    models = []
    for name, (picture, (vertices, uv, faces)) in pictures.items():
        (folder / f"{name}.png").write_bytes(textures.png(picture))
        normal = np.cross(vertices[1] - vertices[0], vertices[2] - vertices[0])
        normals = np.tile(normal / np.linalg.norm(normal), (len(vertices), 1))
        parts = {"picture": (Surface(texture=f"{name}.png"), faces)}
        write_collada(folder / f"{name}.dae", Mesh(vertices=vertices, normals=normals, uv=uv, parts=parts))
        file = f"{beside_world}/{name}"
        models.append(StillModel(name=f"room_{name}", mesh=f"{file}.dae", texture=f"{file}.png", world_from_model=SE3.identity()))
    return models


def _floor(size_m: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Tiles of one image each, cut off at the edge: nothing depends on how a renderer repeats images."""
    tile = textures.FLOOR_TILE_M
    edges = [np.concatenate([np.arange(-side / 2, side / 2 - 1e-9, tile), [side / 2]]) for side in size_m]
    parts = []
    for x0, x1 in zip(edges[0][:-1], edges[0][1:], strict=True):
        for y0, y1 in zip(edges[1][:-1], edges[1][1:], strict=True):
            vertices, uv, faces = _rectangle(np.array([x0, y0, 0.0]), np.array([x1 - x0, 0, 0]), np.array([0, y1 - y0, 0]))
            bottom_left = np.array([0.0, 1.0])
            parts.append((vertices, bottom_left + (uv - bottom_left) * [(x1 - x0) / tile, (y1 - y0) / tile], faces))
    count = len(parts[0][0])
    return (
        np.concatenate([part[0] for part in parts]),
        np.concatenate([part[1] for part in parts]),
        np.concatenate([part[2] + count * i for i, part in enumerate(parts)]),
    )


def _walls(size_m: tuple[float, float]) -> list[tuple[Array, Array]]:
    """Lower left corner and direction along each wall as seen from inside, in the order of `render.model`."""
    x, y = size_m[0] / 2, size_m[1] / 2
    corners = [np.array([*corner, 0.0]) for corner in ((x, -y), (-x, -y), (-x, y), (x, y))]
    return [(corner, corners[(i + 1) % 4] - corner) for i, corner in enumerate(corners)]


def _rectangle(corner: Array, right: Array, up: Array) -> tuple[Array, Array, Array]:
    """An image of its own: vertices (4, 3), uv (4, 2) from the image's top left, faces (2, 3) seen from right x up."""
    vertices = np.array([corner, corner + right, corner + right + up, corner + up])
    return vertices, np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
