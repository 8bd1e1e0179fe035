"""Images on floor, walls and cloth: drawn from a seed, so no file has to be shipped."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from posefuse.core.arrays import Array

FLOOR_TILE_M = 4.0
_FLOOR_PX = 1024
_WALL_PX_PER_M = 128
_SKIRTING_M = 0.10


def floor_picture(floor: str, rng: np.random.Generator) -> Array:
    """(1024, 1024, 3) uint8 of 4 m x 4 m that repeats without a seam."""
    return _FLOORS[floor](rng)


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


def cloth_picture(rng: np.random.Generator) -> Array:
    """(512, 512, 3) uint8 grey weave with folds, to be tinted; repeats without a seam."""
    folds = _smooth_noise(rng, (512, 512), 40) + 0.6 * _smooth_noise(rng, (512, 512), 14)
    weave = rng.standard_normal((512, 512))
    return _uint8(np.repeat((226 + 9 * folds + 5 * weave)[..., None], 3, axis=-1))


def _furnish(wall: Array, length_m: float, height_m: float, rng: np.random.Generator) -> None:
    """Windows, posters, shelves: what a lab's wall shows."""
    at_m = rng.uniform(0.3, 0.9)
    while at_m < length_m - 1.2:
        width_m = float(rng.uniform(0.7, 1.6))
        _DECORATIONS[rng.integers(len(_DECORATIONS))](wall, at_m, min(width_m, length_m - at_m - 0.2), height_m, rng)
        at_m += width_m + float(rng.uniform(0.5, 1.4))


def _window(wall: Array, at_m: float, width_m: float, height_m: float, rng: np.random.Generator) -> None:
    bottom, top = 1.0, min(2.5, height_m - 0.2)
    _rectangle(wall, at_m, width_m, bottom, top, np.array([240, 240, 238]))
    sky = rng.uniform(170, 225)
    _rectangle(wall, at_m + 0.06, width_m / 2 - 0.09, bottom + 0.06, top - 0.06, np.array([sky, sky + 12, sky + 25]))
    _rectangle(
        wall, at_m + width_m / 2 + 0.03, width_m / 2 - 0.09, bottom + 0.06, top - 0.06, np.array([sky, sky + 10, sky + 20])
    )


def _poster(wall: Array, at_m: float, width_m: float, height_m: float, rng: np.random.Generator) -> None:
    bottom = rng.uniform(1.1, 1.4)
    tall = min(width_m * 0.8, height_m - bottom - 0.3)
    _rectangle(wall, at_m, width_m * 0.7, bottom, bottom + tall, np.array([50, 46, 42]))
    for _ in range(6):
        x, y = rng.uniform(0.03, 0.45) * width_m, rng.uniform(0.05, 0.6) * tall
        _rectangle(
            wall, at_m + x, rng.uniform(0.08, 0.22) * width_m, bottom + y, bottom + y + rng.uniform(0.1, 0.35) * tall,
            rng.uniform(60, 220, 3),
        )  # fmt: skip


def _shelf(wall: Array, at_m: float, width_m: float, height_m: float, rng: np.random.Generator) -> None:
    _rectangle(wall, at_m, width_m, 0.0, min(1.7, height_m - 0.3), np.array([128, 104, 80]) + rng.uniform(-20, 20))
    for level in (0.12, 0.52, 0.92, 1.32):
        _rectangle(wall, at_m + 0.04, width_m - 0.08, level, min(level + 0.34, height_m - 0.4), np.array([70, 58, 48]))
        x = at_m + 0.06
        while x < at_m + width_m - 0.12:
            thick = rng.uniform(0.03, 0.07)
            _rectangle(wall, x, thick, level, min(level + rng.uniform(0.2, 0.31), height_m - 0.42), rng.uniform(50, 190, 3))
            x += thick + 0.005


_DECORATIONS = (_window, _poster, _shelf, _poster)


def _rectangle(wall: Array, at_m: float, width_m: float, bottom_m: float, top_m: float, colour: Array) -> None:
    rows = [len(wall) - round(edge * _WALL_PX_PER_M) for edge in (top_m, bottom_m)]
    columns = [round(edge * _WALL_PX_PER_M) for edge in (at_m, at_m + width_m)]
    wall[max(0, rows[0]) : max(0, rows[1]), max(0, columns[0]) : max(0, columns[1])] = colour


def _wood(rng: np.random.Generator) -> Array:
    planks = 32
    width = _FLOOR_PX // planks
    floor = np.empty((_FLOOR_PX, _FLOOR_PX, 3))
    for i in range(planks):
        grain = cv2.GaussianBlur(rng.standard_normal((_FLOOR_PX, width)), (0, 0), sigmaX=0.8, sigmaY=24)
        plank: Array = np.array([163.0, 125.0, 86.0]) + 55 * grain[..., None]
        ends = np.sort(rng.integers(0, _FLOOR_PX, 3))
        plank *= np.repeat(rng.uniform(0.84, 1.1, 4), np.diff([0, *ends, _FLOOR_PX]))[:, None, None]
        plank[ends] *= 0.6
        plank[:, 0] *= 0.7
        floor[:, i * width : (i + 1) * width] = plank
    return _uint8(floor)


def _concrete(rng: np.random.Generator) -> Array:
    shape = (_FLOOR_PX, _FLOOR_PX)
    grey = 148 + 14 * _smooth_noise(rng, shape, 60) + 7 * _smooth_noise(rng, shape, 8) + 4 * rng.standard_normal(shape)
    return _uint8(np.repeat(grey[..., None], 3, axis=-1) * [1.0, 0.99, 0.96])


def _tiles(rng: np.random.Generator) -> Array:
    count = 8
    width = _FLOOR_PX // count
    shades = np.kron(rng.uniform(0.9, 1.06, (count, count)), np.ones((width, width)))
    floor = np.array([186, 184, 176]) * shades[..., None] + 3 * rng.standard_normal((_FLOOR_PX, _FLOOR_PX, 1))
    joints = np.arange(_FLOOR_PX) % width < 2
    floor[joints] = floor[:, joints] = [120, 118, 112]
    return _uint8(floor)


def _plain(rng: np.random.Generator) -> Array:
    return _uint8(np.array([150, 150, 150]) + 2 * rng.standard_normal((_FLOOR_PX, _FLOOR_PX, 1)))


_FLOORS: dict[str, Callable[[np.random.Generator], Array]] = {
    "wood": _wood,
    "concrete": _concrete,
    "tiles": _tiles,
    "plain": _plain,
}


def _smooth_noise(rng: np.random.Generator, shape: tuple[int, int], size_px: float) -> Array:
    """Noise of unit variance, smooth over `size_px`, that joins at its edges."""
    rows, columns = (np.fft.fftfreq(side)[:, None] ** 2 for side in shape)
    keep = np.exp(-2 * (np.pi * size_px / 2) ** 2 * (rows + columns.T))
    noise = np.fft.ifft2(np.fft.fft2(rng.standard_normal(shape)) * keep).real
    return np.asarray(noise / noise.std())


def _uint8(picture: Array) -> Array:
    return np.clip(np.round(picture), 0, 255).astype(np.uint8)
