"""Calibration objects: settings, the textured mesh that is rendered, and how they move.

The own axes of a prop: origin at its centre; a board's x to the right and y up as printed, z out of the printed side.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import cv2
import numpy as np
from annotated_types import Ge, Gt
from pydantic import Field

from posefuse.calibration.targets.kinds import black_modules, board_picture, dictionary_of
from posefuse.core import SE3, ConfigError
from posefuse.core.arrays import Array, freeze_fields
from posefuse.foundation.settings import settings

Point = tuple[float, float, float]
# incommensurate, so that the wave does not repeat within a session
_OVERTONES = np.array([1.0, 1.618, 2.414])


@settings
class StillPath:
    """Stays where it is.

    Attributes:
        position_m: of its centre. yaw_deg, pitch_deg, roll_deg: turned about its own z, then y, then x axis.
    """

    kind: Literal["still"]
    position_m: Point = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0
    pitch_deg: float = 0.0
    roll_deg: float = 0.0


@settings
class WavedPath:
    """Waved smoothly and irregularly through a box, turning all the while, as one calibrates cameras by hand.

    Attributes:
        centre_m, extent_m: the box its centre stays in.
        speed_mps: typical speed. turn_dps: typical rate of turn in degrees per second.
        seed: None takes the scene's.
    """

    kind: Literal["waved"]
    centre_m: Point = (0.0, 0.0, 1.1)
    extent_m: tuple[Annotated[float, Ge(0)], Annotated[float, Ge(0)], Annotated[float, Ge(0)]] = (2.0, 2.0, 1.2)
    speed_mps: Annotated[float, Ge(0)] = 0.6
    turn_dps: Annotated[float, Ge(0)] = 45.0
    seed: int | None = None


PathSettings = Annotated[StillPath | WavedPath, Field(discriminator="kind")]


def poses_on_path(path: StillPath | WavedPath, t_s: Array, seed: int) -> SE3:
    """World poses (T,) at times (T,) in seconds since the start of the scene."""
    t_s = np.asarray(t_s, np.float64)
    if isinstance(path, StillPath):
        angles = np.broadcast_to(np.deg2rad([path.yaw_deg, path.pitch_deg, path.roll_deg]), (len(t_s), 3))
        return _turned(angles, np.broadcast_to(path.position_m, (len(t_s), 3)))
    return _waved(path, t_s, seed if path.seed is None else path.seed)


def _waved(path: WavedPath, t_s: Array, seed: int) -> SE3:
    rng = np.random.default_rng([seed, 11])
    half = np.array(path.extent_m) / 2
    # a sine of amplitude A and rate w has the mean speed 2 A w / pi; three axes and overtones share it
    rate_hz = path.speed_mps / max(4 * float(np.linalg.norm(half)), 1e-9)
    place = np.array(path.centre_m) + half * _waves(rng, rate_hz, t_s)
    # rolling on and on shows every side; a pitch near a right angle would make yaw and roll one
    turn = np.deg2rad(path.turn_dps) * t_s[:, None] * np.array([0.8, 0.0, 0.6])
    sway = np.array([0.6, 1.1, 0.6]) * _waves(rng, path.turn_dps / 360.0, t_s)
    return _turned(turn + sway, place)


def _waves(rng: np.random.Generator, rate_hz: float, t_s: Array) -> Array:
    """(T, 3) smooth irregular curves within [-1, 1]."""
    weight = rng.uniform(0.4, 1.0, (3, 3))
    weight = weight / weight.sum(axis=0)
    rates = rate_hz * _OVERTONES[:, None] * rng.uniform(0.8, 1.25, (3, 3))
    phase = rng.uniform(0, 2 * np.pi, (3, 3))
    waves = np.sin(2 * np.pi * rates * t_s[:, None, None] + phase)
    return np.asarray((weight * waves).sum(axis=1))


def _turned(yaw_pitch_roll: Array, xyz: Array) -> SE3:
    """Poses whose rotation is Rz(yaw) Ry(pitch) Rx(roll)."""
    zero = np.zeros(xyz.shape[:-1])
    yaw = SE3.from_rotvec(np.stack([zero, zero, yaw_pitch_roll[..., 0]], axis=-1), xyz)
    pitch = SE3.from_rotvec(np.stack([zero, yaw_pitch_roll[..., 1], zero], axis=-1), np.zeros_like(xyz))
    roll = SE3.from_rotvec(np.stack([yaw_pitch_roll[..., 2], zero, zero], axis=-1), np.zeros_like(xyz))
    return yaw @ pitch @ roll


# about so wide is a face of a cube: two rows of three are no more than 2048 x 1024
_FACE_PX = 500
_PLATE_M = 0.004
# of the faces of a box, the side of a plate that is printed
_PRINTED = 4
# white border around the squares of a board
_MARGIN_M = 0.02
_PAPER_WHITE = 235
# outward normal, right and up of each face as printed; right x up = normal
_CUBE_FACES = np.array(
    [
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
        [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
        [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
        [[0, 0, -1], [1, 0, 0], [0, -1, 0]],
    ],
    dtype=np.float64,
)
# corners of a face to its right and up: top left first, then clockwise as seen from outside; and in its image, whose y is down
_SQUARE = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
_SQUARE_UV = _SQUARE * [1, -1]
# (6, 4, 3) corners of the faces of a box, in half edges, and the triangles of all faces
_BOX = _CUBE_FACES[:, :1] + _SQUARE @ _CUBE_FACES[:, 1:]
BOX_TRIANGLES = (4 * np.arange(6)[:, None, None] + [[0, 2, 1], [0, 3, 2]]).reshape(-1, 3)


@settings
class ArucoCube:
    """A cube with one ArUco marker on each face.

    Attributes:
        side_m: edge of the cube. marker_m: edge of a marker's black square.
        dictionary: OpenCV's name. first_id: of the face that looks along +x; then -x, +y, -y, +z, -z.
    """

    kind: Literal["aruco_cube"]
    name: str = "cube"
    side_m: Annotated[float, Gt(0)] = 0.20
    marker_m: Annotated[float, Gt(0)] = 0.15
    dictionary: str = "DICT_4X4_50"
    first_id: Annotated[int, Ge(0)] = 0
    path: PathSettings = WavedPath(kind="waved")


@settings
class CharucoBoard:
    """A flat ChArUco board.

    Attributes:
        squares: columns and rows. square_m: edge of a square. marker_m: edge of the markers in them.
    """

    kind: Literal["charuco_board"]
    name: str = "board"
    squares: tuple[Annotated[int, Ge(3)], Annotated[int, Ge(3)]] = (7, 5)
    square_m: Annotated[float, Gt(0)] = 0.10
    marker_m: Annotated[float, Gt(0)] = 0.075
    dictionary: str = "DICT_4X4_50"
    path: PathSettings = WavedPath(kind="waved")


@settings
class GroundTile:
    """One ArUco marker on a thin plate; lies at the world's origin, facing up, unless moved.

    Attributes:
        side_m: edge of the plate. marker_m: edge of the marker's black square.
    """

    kind: Literal["ground_tile"]
    name: str = "tile"
    side_m: Annotated[float, Gt(0)] = 0.60
    marker_m: Annotated[float, Gt(0)] = 0.50
    dictionary: str = "DICT_4X4_50"
    id: Annotated[int, Ge(0)] = 40
    path: PathSettings = StillPath(kind="still")


PropSettings = Annotated[ArucoCube | CharucoBoard | GroundTile, Field(discriminator="kind")]
Path = StillPath | WavedPath


@dataclass(frozen=True, eq=False, kw_only=True)
class Prop:
    """A rigid thing with markers on it.

    Attributes:
        vertices: (24, 3) of a box, see `BOX_TRIANGLES`. uv: (24, 2) texture coordinates from the image's top left.
        texture: (H, W, 3) uint8 RGB.
        path: how it moves.
    """

    vertices: Array
    uv: Array
    texture: Array
    path: Path

    def __post_init__(self) -> None:
        freeze_fields(self, {"texture": np.uint8, "vertices": np.float64, "uv": np.float64})


def prop_from_settings(prop: ArucoCube | CharucoBoard | GroundTile) -> Prop:
    """Geometry and texture; raises ConfigError for a marker that does not fit or is not in its dictionary."""
    if isinstance(prop, CharucoBoard):
        return _board(prop)
    if prop.marker_m >= prop.side_m:
        raise ConfigError(f"prop {prop.name}: marker_m {prop.marker_m} leaves no white border inside side_m {prop.side_m}")
    if isinstance(prop, GroundTile):
        return _plate(prop.path, np.full(2, prop.side_m), *_marker_print(prop, prop.id))
    return _cube(prop)


def _cube(prop: ArucoCube) -> Prop:
    pictures, uv = [], []
    for i in range(6):
        picture, half_uv = _marker_print(prop, prop.first_id + i)
        pictures.append(picture)
        uv.append((0.5 + half_uv * _SQUARE_UV + [i % 3, i // 3]) / [3, 2])
    atlas = np.vstack([np.hstack(pictures[:3]), np.hstack(pictures[3:])])
    return _made(prop.path, prop.side_m / 2 * _BOX.reshape(-1, 3), np.concatenate(uv), atlas)


def _board(prop: CharucoBoard) -> Prop:
    if prop.marker_m >= prop.square_m:
        raise ConfigError(f"prop {prop.name}: marker_m {prop.marker_m} does not fit into square_m {prop.square_m}")
    columns, rows = prop.squares
    dictionary = _dictionary(prop.name, prop.dictionary, (columns * rows) // 2 - 1)
    board = cv2.aruco.CharucoBoard((columns, rows), prop.square_m, prop.marker_m, dictionary)
    square_px = max(48, 1536 // max(columns, rows))
    full_m = np.array([columns, rows]) * prop.square_m + 2 * _MARGIN_M
    return _plate(prop.path, full_m, *_printed(board_picture(board, square_px), square_px / prop.square_m, full_m))


def _made(path: Path, vertices: Array, uv: Array, picture: Array) -> Prop:
    """A prop of vertices and texture coordinates of a box, and an image."""
    texture, used = _power_of_two(picture)
    return Prop(vertices=vertices, uv=uv * used, texture=texture, path=path)


def _plate(path: Path, size_m: Array, picture: Array, half_uv: Array) -> Prop:
    """A thin box, printed on its +z side and plain elsewhere."""
    # the unprinted sides show one white spot of the border
    uv = np.tile(0.5 - half_uv * np.ones(2), (6, 4, 1))
    uv[_PRINTED] = 0.5 + half_uv * _SQUARE_UV
    return _made(path, (_BOX * np.array([*size_m, _PLATE_M]) / 2).reshape(-1, 3), uv.reshape(-1, 2), picture)


def _marker_print(prop: ArucoCube | GroundTile, marker_id: int) -> tuple[Array, Array]:
    """One marker in the middle of a square side, see `_printed`."""
    black = black_modules(_dictionary(prop.name, prop.dictionary, marker_id), marker_id)
    module_px = int(_FACE_PX * prop.marker_m / prop.side_m / len(black))
    if module_px < 1:
        raise ConfigError(f"prop {prop.name}: marker_m {prop.marker_m} is too small to be drawn on side_m {prop.side_m}")
    white = 1 - np.kron(black, np.ones((module_px, module_px)))
    return _printed(white, len(black) * module_px / prop.marker_m, np.full(2, prop.side_m))


def _printed(white: Array, px_per_m: float, size_m: Array) -> tuple[Array, Array]:
    """White shares (h, w) in the middle of a paper of (2,) m: the RGB image, and half the paper in texture coordinates (2,)."""
    size_px = np.array(white.shape[::-1])
    margin_px = int(np.ceil((size_m * px_per_m - size_px).max() / 2)) + 1
    picture = np.pad(np.round(_PAPER_WHITE * white).astype(np.uint8), margin_px, constant_values=_PAPER_WHITE)
    return np.repeat(picture[..., None], 3, axis=-1), size_m * px_per_m / (size_px + 2 * margin_px) / 2


def _dictionary(name: str, dictionary_name: str, highest_id: int) -> cv2.aruco.Dictionary:
    dictionary: cv2.aruco.Dictionary = dictionary_of(dictionary_name)
    if highest_id >= len(dictionary.bytesList):
        raise ConfigError(
            f"prop {name}: {dictionary_name} has {len(dictionary.bytesList)} markers, marker {highest_id} is needed"
        )
    return dictionary


def _power_of_two(picture: Array) -> tuple[Array, Array]:
    """The image padded to sides that halve without a rest, and the share (2,) of width and height it fills.

    OpenGL draws small textures from ones halved again and again; a rest would move what is printed on them.
    """
    height, width = picture.shape[:2]
    full_height, full_width = (1 << (side - 1).bit_length() for side in (height, width))
    padding = ((0, full_height - height), (0, full_width - width), (0, 0))
    return np.pad(picture, padding, constant_values=_PAPER_WHITE), np.array([width / full_width, height / full_height])
