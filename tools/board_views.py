"""Images of a ChArUco board as a camera of known focal length sees it: python tools/board_views.py FOLDER

For `tools/package.py`: `posefuse calibrate intrinsics` finds this camera from them, or refuses.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

FOCAL_PX = 700.0
SIZE_WH = (960, 720)
VIEWS = 24
# squares across and down, and their edges in metres: those of BOARD in tools/package.py
BOARD = cv2.aruco.CharucoBoard((5, 7), 0.030, 0.022, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
_PX_PER_M = 5000


def main(folder: Path) -> None:
    """Draw the images."""
    folder.mkdir()
    flat = BOARD.generateImage((round(0.15 * _PX_PER_M), round(0.21 * _PX_PER_M)), marginSize=0)
    flat = cv2.copyMakeBorder(flat, 100, 100, 100, 100, cv2.BORDER_CONSTANT, value=255)
    for number, board_to_image in enumerate(homographies()):
        image = cv2.warpPerspective(flat, board_to_image, SIZE_WH, flags=cv2.INTER_AREA, borderValue=128)
        cv2.imwrite(str(folder / f"{number:03d}.png"), image)


def homographies() -> list[np.ndarray]:
    """(3, 3) each: from pixels of the drawn board to pixels of the camera."""
    random = np.random.default_rng(5)
    width, height = SIZE_WH
    camera = np.array([[FOCAL_PX, 0, (width - 1) / 2], [0, FOCAL_PX, (height - 1) / 2], [0, 0, 1]])
    metres = np.array([[1, 0, -100 - 375], [0, 1, -100 - 525], [0, 0, _PX_PER_M]]) / _PX_PER_M
    views = []
    for _ in range(VIEWS):
        turn = cv2.Rodrigues(random.uniform(-0.6, 0.6, 3))[0]
        place = np.array([random.uniform(-0.14, 0.14), random.uniform(-0.1, 0.1), random.uniform(0.3, 0.5)])
        views.append(camera @ np.column_stack([turn[:, :2], place]) @ metres)
    return views


if __name__ == "__main__":
    main(Path(sys.argv[1]))
