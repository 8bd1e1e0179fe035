"""Scenes of the simulation, out of the content of a scene file."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from posefuse.foundation.settings import settings_from_mapping
from posefuse_sim.props import ArucoCube, CharucoBoard, GroundTile
from posefuse_sim.scene import Scene

PLAIN_ROOM = {"floor": "plain", "walls": "plain", "shadows": False}


def scene(**content: Any) -> Scene:
    """A second of four cameras in a ring, where nothing else is said."""
    return settings_from_mapping({"duration_s": 1.0, "cameras": {"kind": "ring"}} | content, Scene, where="scene")


def listed(*cameras: dict[str, Any]) -> dict[str, Any]:
    """Cameras at places of their own."""
    return {"kind": "list", "cameras": cameras}


def still(position_m: Sequence[float], **turned: float) -> dict[str, Any]:
    """The path of a prop that stays in its place."""
    return {"kind": "still", "position_m": position_m, **turned}


# half the thickness of what is flat: the printed side of a board or a tile
_FRONT_M = 0.002
# corners in half edges to the right and up: top left first, then clockwise as printed
_CORNERS = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]])
# outward normal and right of each face of a cube
_FACES = (
    ([1, 0, 0], [0, 1, 0]), ([-1, 0, 0], [0, -1, 0]), ([0, 1, 0], [-1, 0, 0]), ([0, -1, 0], [1, 0, 0]), ([0, 0, 1], [1, 0, 0]),
    ([0, 0, -1], [1, 0, 0]),
)  # fmt: skip


def chess_corners(board: CharucoBoard) -> np.ndarray:
    """(Q, 3) inner chessboard corners of a ChArUco board in its own axes, in OpenCV's order."""
    return _on_board(board, np.asarray(_opencv_board(board).getChessboardCorners()))


def marker_corners(prop: ArucoCube | CharucoBoard | GroundTile) -> np.ndarray:
    """(M, 4, 3) corners of the markers of a prop in its own axes, in OpenCV's order."""
    if isinstance(prop, CharucoBoard):
        return _on_board(prop, np.array(_opencv_board(prop).getObjPoints()))
    flat = prop.marker_m / 2 * _CORNERS
    if isinstance(prop, GroundTile):
        return np.append(flat, np.full((4, 1), _FRONT_M), axis=1)[None]
    return np.array([prop.side_m / 2 * np.array(n) + flat @ [right, np.cross(n, right)] for n, right in _FACES])


def _opencv_board(board: CharucoBoard) -> cv2.aruco.CharucoBoard:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    return cv2.aruco.CharucoBoard(board.squares, board.square_m, board.marker_m, dictionary)


def _on_board(board: CharucoBoard, points: np.ndarray) -> np.ndarray:
    """Points of OpenCV, whose board has its origin at the top left and y down."""
    across, down, _ = np.moveaxis(points, -1, 0)
    columns, rows = board.squares
    x, y = across - columns * board.square_m / 2, rows * board.square_m / 2 - down
    return np.stack([x, y, np.full_like(x, _FRONT_M)], axis=-1)
