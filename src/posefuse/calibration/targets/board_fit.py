"""Corners of a ChArUco board from all that is around them: the board is drawn as it lies and laid over the image.

OpenCV refines a corner by the edges that meet in it, in a window that stays clear of the markers. In a small or oblique
square that leaves a few pixels, and the corner is off by 0.2 px, some by 1 px. A drawing has the markers, too: what is
around a corner is moved until it correlates best with the image (Evangelidis and Psarakis 2008), which brightness and
contrast do not change.
"""

from __future__ import annotations

import cv2
import numpy as np

from posefuse.core.arrays import Array

from .kinds import Charuco

# of a square in the largest picture, whose sides have no more px than this
_SQUARE_PX, _MOST_PX = 480, 4000
# the board is drawn from a picture with so many px to one of the image, so many times finer than the image, and as blurred as
# a sharp image that is blurred by `_BLUR_PX`, which leaves less of its own blur
_PICTURE_FINER, _DRAWN_FINER, _DRAWN_BLUR_PX, _BLUR_PX = 2, 2, 1.2, 1.0
# what counts as around a corner: in squares; in px at least, and at most, so that a lens does not bend it
_AROUND_SHARE, _LEAST_PX, _MOST_AROUND_PX = 0.45, 4, 25
# a corner lies nearer than this to where it was read: OpenCV errs by 1 px
_MOST_MOVED_PX, _MOST_MOVED_SHARE = 1.5, 0.1
# correlation, or something else is there (a finger, glare): strong blur, noise and a tone curve leave more than 0.85
_LEAST_ALIKE = 0.8
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-4)


class BoardFit:
    """One side of a board, laid over images."""

    def __init__(self, target: Charuco, side: int) -> None:
        self._columns = target.columns
        square_px = min(_SQUARE_PX, _MOST_PX // max(target.columns, target.rows))
        size = (target.columns * square_px, target.rows * square_px)
        printed = target.board(side).generateImage(size)
        # with a square of white around it; by the px of a square
        self._pictures = {square_px: cv2.copyMakeBorder(printed, *[square_px] * 4, cv2.BORDER_CONSTANT, value=255)}

    def refined(self, grey: Array, corner: Array, xy_img: Array) -> Array:
        """(n, 2) px of four or more corners (n,) that were read at xy_img (n, 2); NaN where something else is seen there."""
        squares = np.stack(np.divmod(corner, self._columns - 1)[::-1], axis=1) + 1.0
        px_from_squares: Array | None = cv2.findHomography(squares, xy_img)[0]
        if px_from_squares is None:
            return np.full(xy_img.shape, np.nan)
        drawn_px, size_px = _laid(px_from_squares, squares)
        # corners in one line tell nothing across it
        if not _LEAST_PX < size_px.min() <= size_px.max() < max(grey.shape):
            return np.full(xy_img.shape, np.nan)
        most = 2 * size_px.max()
        low = np.maximum(np.floor(xy_img.min(axis=0) - most), 0).astype(int)
        high = np.minimum(np.ceil(xy_img.max(axis=0) + most), grey.shape[::-1]).astype(int)
        image = cv2.GaussianBlur(grey[low[1] : high[1], low[0] : high[0]].astype(np.float32), (0, 0), _BLUR_PX)
        drawing = self._drawn(px_from_squares, size_px.max(), low, high)
        moves = [
            _moved(drawing, image, at, by, px) for at, by, px in zip(drawn_px - low, xy_img - drawn_px, size_px, strict=True)
        ]
        return np.asarray(drawn_px + moves)

    def _drawn(self, px_from_squares: Array, square_px: float, low: Array, high: Array) -> Array:
        """What of the board lies in the image between two corners (x, y), as a sharp camera sees it."""
        picture, picture_px = self._picture(square_px)
        squares_from_picture = np.array([[1, 0, 0.5 - picture_px], [0, 1, 0.5 - picture_px], [0, 0, picture_px]]) / picture_px
        fine = np.array([[_DRAWN_FINER, 0, (_DRAWN_FINER - 1) / 2], [0, _DRAWN_FINER, (_DRAWN_FINER - 1) / 2], [0, 0, 1.0]])
        shifted = np.array([[1, 0, -low[0]], [0, 1, -low[1]], [0, 0, 1.0]])
        width, height = (high - low).tolist()
        size = (_DRAWN_FINER * width, _DRAWN_FINER * height)
        drawn = cv2.warpPerspective(
            picture, fine @ shifted @ px_from_squares @ squares_from_picture, size, borderMode=cv2.BORDER_REPLICATE
        )
        return cv2.GaussianBlur(
            cv2.resize(drawn, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32), (0, 0), _DRAWN_BLUR_PX
        )

    def _picture(self, square_px: float) -> tuple[Array, int]:
        """The printed side, a little finer than the image, and the px of its squares."""
        largest = max(self._pictures)
        # few sizes are kept
        wanted = min(largest, 2 ** int(np.ceil(np.log2(_PICTURE_FINER * square_px))))
        if wanted not in self._pictures:
            height, width = (side // largest * wanted for side in self._pictures[largest].shape)
            self._pictures[wanted] = cv2.resize(self._pictures[largest], (width, height), interpolation=cv2.INTER_AREA)
        return self._pictures[wanted], wanted


def _laid(px_from_squares: Array, squares: Array) -> tuple[Array, Array]:
    """Where places (n, 2) of the board lie in the image, and the root of the area (n,) of a square there."""

    def at(places: Array) -> Array:
        return np.asarray(cv2.perspectiveTransform(places[None], px_from_squares)[0])

    right, down = (at(squares + half) - at(squares - half) for half in (np.array([0.5, 0]), np.array([0, 0.5])))
    return at(squares), np.sqrt(np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0]))


def _moved(drawing: Array, image: Array, at: Array, by: Array, square_px: float) -> Array:
    """By how much (x, y) what is drawn around a place lies elsewhere in the image of the same size; begins at `by`."""
    around = int(np.clip(round(_AROUND_SHARE * square_px), _LEAST_PX, _MOST_AROUND_PX))
    most_px = max(_MOST_MOVED_PX, _MOST_MOVED_SHARE * square_px)
    middle, sides = np.round(at).astype(int), np.array(image.shape[::-1])
    low, high = (np.clip(middle + sign * around + (sign > 0), 0, sides) for sign in (-1, 1))
    margin = int(np.ceil(most_px + np.abs(by).max()))
    outer_low, outer_high = np.clip(low - margin, 0, sides), np.clip(high + margin, 0, sides)
    start = (low - outer_low + by).astype(np.float32)
    part = drawing[low[1] : high[1], low[0] : high[0]]
    seen = image[outer_low[1] : outer_high[1], outer_low[0] : outer_high[0]]
    warp = np.column_stack([np.eye(2, dtype=np.float32), start])
    try:
        alike, found = cv2.findTransformECC(part, seen, warp, cv2.MOTION_TRANSLATION, _STOP, None, 1)
    except cv2.error:
        # it moved out of sight
        return np.full(2, np.nan)
    moved = np.asarray(found[:, 2] - (low - outer_low), float)
    return moved if alike > _LEAST_ALIKE and np.abs(moved - by).max() < most_px else np.full(2, np.nan)
