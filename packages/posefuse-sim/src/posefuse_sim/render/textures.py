"""Images on floor and walls: drawn from a seed, so no file has to be shipped."""

from __future__ import annotations

import cv2
import numpy as np

from posefuse.core.arrays import Array

FLOOR_TILE_M = 4.0
_FLOOR_PX = 1024
_WALL_PX_PER_M = 128
_SKIRTING_M = 0.10
# of a floor: its colour, how many boards lie along and across the image, how much their shades differ, and how uneven it is
_FLOORS = {
    "wood": ((163.0, 125.0, 86.0), (4, 32), 0.13, 4.0),
    "concrete": ((148.0, 147.0, 142.0), (1, 1), 0.0, 14.0),
    "tiles": ((186.0, 184.0, 176.0), (8, 8), 0.08, 2.0),
    "plain": ((150.0, 150.0, 150.0), (1, 1), 0.0, 0.0),
}
_JOINT = 0.65


def png(picture: Array) -> bytes:
    """An RGB or grey uint8 image as PNG."""
    _, data = cv2.imencode(".png", picture[..., ::-1] if picture.ndim == 3 else picture)
    return data.tobytes()


def floor_picture(floor: str, rng: np.random.Generator) -> Array:
    """(1024, 1024, 3) uint8 of 4 m x 4 m that repeats without a seam."""
    colour, boards, spread, uneven = _FLOORS[floor]
    shape = (_FLOOR_PX, _FLOOR_PX)
    rows, columns = (_FLOOR_PX // count for count in boards)
    shade = np.kron(rng.uniform(1 - spread, 1 + spread, boards), np.ones((rows, columns)))
    if spread:
        shade[::rows] *= _JOINT
        shade[:, ::columns] *= _JOINT
    grain = 3 * rng.standard_normal(shape) + uneven * _smooth_noise(rng, shape, 30)
    return _uint8(shade[..., None] * colour + grain[..., None])


def wall_picture(walls: str, length_m: float, height_m: float, rng: np.random.Generator) -> Array:
    """(h, w, 3) uint8 of one whole wall seen from inside, 128 px per metre."""
    height, width = (round(side * _WALL_PX_PER_M) for side in (height_m, length_m))
    wall = np.empty((height, width, 3))
    wall[:] = np.array([222, 218, 208]) + rng.uniform(-8, 8, 3)
    wall += 9 * _smooth_noise(rng, (height, width), 90)[..., None] + 3 * rng.standard_normal((height, width, 1))
    # light falls off towards the floor
    wall *= np.linspace(1.02, 0.86, height)[:, None, None]
    if walls == "office":
        _furnish(wall, length_m, height_m, rng)
    skirting = round(_SKIRTING_M * _WALL_PX_PER_M)
    wall[-skirting:] = [96, 84, 74]
    return _uint8(wall)


def _furnish(wall: Array, length_m: float, height_m: float, rng: np.random.Generator) -> None:
    """Windows, posters, shelves: areas with parts of other colours, from the floor or higher up."""
    at_m = rng.uniform(0.3, 0.9)
    while at_m < length_m - 1.2:
        width_m, bottom_m, tall_m = rng.uniform([0.7, 0.0, 0.8], [1.6, 1.2, 1.6])
        tall_m = min(tall_m, height_m - bottom_m - 0.2)
        width_m = min(width_m, length_m - at_m - 0.2)
        _rectangle(wall, at_m, width_m, bottom_m, bottom_m + tall_m, rng.uniform(45, 240) * rng.uniform(0.8, 1.0, 3))
        for x, y, wide, tall in rng.uniform([0.02, 0.02, 0.04, 0.1], [0.75, 0.65, 0.23, 0.33], (10, 4)):
            low_m = bottom_m + y * tall_m
            _rectangle(wall, at_m + x * width_m, wide * width_m, low_m, low_m + tall * tall_m, rng.uniform(70, 210, 3))
        at_m += width_m + float(rng.uniform(0.5, 1.4))


def _rectangle(wall: Array, at_m: float, width_m: float, bottom_m: float, top_m: float, colour: Array) -> None:
    rows = [len(wall) - round(edge * _WALL_PX_PER_M) for edge in (top_m, bottom_m)]
    columns = [round(edge * _WALL_PX_PER_M) for edge in (at_m, at_m + width_m)]
    wall[max(0, rows[0]) : max(0, rows[1]), max(0, columns[0]) : max(0, columns[1])] = colour


def _smooth_noise(rng: np.random.Generator, shape: tuple[int, int], size_px: float) -> Array:
    """Noise of unit variance, smooth over `size_px`, that joins at its edges."""
    rows, columns = (np.fft.fftfreq(side)[:, None] ** 2 for side in shape)
    keep = np.exp(-2 * (np.pi * size_px / 2) ** 2 * (rows + columns.T))
    noise = np.fft.ifft2(np.fft.fft2(rng.standard_normal(shape)) * keep).real
    return np.asarray(noise / noise.std())


def _uint8(picture: Array) -> Array:
    return np.clip(np.round(picture), 0, 255).astype(np.uint8)
