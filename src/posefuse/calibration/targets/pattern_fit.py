"""Corners of printed patterns from all of their pixels: the known pattern is laid over the image and moved until it fits.

Of a loose marker: a blurred corner is rounded and a blurred edge is drawn aside by the edge next to it, by a few hundredths of
a px each: outwards on all four sides, that makes a marker of 30 px some tenths of a per cent too large, and with it the whole
room. Here the blur is part of what is fitted (Gauss-Newton on grey values, after Lucas and Kanade 1981), and the edges of the
bits inside, which blur moves the other way, hold the size. Where a marker is seen askew, blur along its sides is correlated.

Of a ChArUco board: OpenCV refines a corner by the edges that meet in it, in a window that stays clear of the markers. In a small
or oblique square that leaves a few pixels, and the corner is off by 0.2 px, some by 1 px. Here the board is drawn as it lies,
markers included, and what is around a corner is moved until it correlates best with the image (Evangelidis and Psarakis 2008),
which brightness and contrast do not change. Blur moves these corners little: they are the same from all sides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.special import factorial, ndtr

from posefuse.core.arrays import SIGMA_PER_MAD, Array

from .kinds import Charuco, board_picture

# white seen around the marker, in modules: all printed markers have that much
_MARGIN = 0.6
_MOST_PIXELS = 3000
# pixels along the edges of a marker of more than that: so far from an edge on both sides, in px or in spreads of the blur
_EDGE_PIXELS, _EDGE_PX, _EDGE_SPREADS, _EDGE_ACROSS = 3000, 3.0, 2.5, 9
# the first rounds look at every third pixel
_ROUGH_ROUNDS, _ROUGH_STEP, _ROUNDS, _SETTLED_PX = 3, 3, 10, 0.02
_FIRST_BLUR, _LEAST_BLUR, _MOST_BLUR = 0.3, 0.02, 0.8
# and no image is sharper than its pixels
_LEAST_BLUR_PX = 0.3
# how well blur (log) and tone curve (log of the exponent) are known beforehand
_BLUR_SIGMA, _TONE_SIGMA = 1.0, 0.4
# a lens bends a marker of half-side s px in an image of w px by about this times s^2 / w
_BEND_SHARE = 0.08
_LEAST_CONTRAST_DN = 12.0
# of a series; the next, at most the fourth part of a correlation to the fourth, moves no corner by 0.03 px
_TERMS = 4
# of their derivatives by u and v
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 0), (2, 0))
# this share of the pixels lies within this share of the contrast, or it is not that marker (fingers may hide the rest);
# and its corners within this share of a module of where they were read
_FITTING_SHARE, _MOST_MISFIT, _MOST_MOVED = 0.85, 0.15, 0.8
# grey values are known to sensor noise and to what the model leaves out of an edge
_NOISE_DN, _EDGE_SHARE = 2.0, 0.04
_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@dataclass(frozen=True, eq=False)
class _Look:
    """What is fitted: where the marker lies, and how the image came about.

    Attributes:
        px_from_uv: (3, 3) homography to px; u right and v down are -1 ... 1 from edge to edge. Its last entry is 1.
        bend: (2,) px by which the lens pushes the corners aside.
        blur: (2,) log of the spread along u and v, in modules. tone: log of the exponent of the tone curve.
        levels: (4,) grey of black, rise to white, and change of that rise with u and v.
        least_blur: in modules.
    """

    px_from_uv: Array
    bend: Array
    blur: Array
    tone: float
    levels: Array
    least_blur: float = _LEAST_BLUR

    @property
    def corners(self) -> Array:
        """(4, 2) px."""
        return _moved(self.px_from_uv, _SQUARE) + self.bend

    def stepped(self, step: Array) -> _Look:
        """Moved by a step (17,) of all parameters in the order above."""
        blur = np.clip(self.blur + step[10:12], np.log(self.least_blur), np.log(_MOST_BLUR))
        moved = self.px_from_uv + np.append(step[:8], 0.0).reshape(3, 3)
        bend, tone, levels = self.bend + step[8:10], self.tone + float(step[12]), self.levels + step[13:]
        return replace(self, px_from_uv=moved, bend=bend, blur=blur, tone=tone, levels=levels)


def fit_marker(grey: Array, quad: Array, black: Array) -> Array | None:
    """Corners (4, 2) px of a marker in a grey image, or None when its pattern does not fit there.

    Args:
        grey: (H, W) uint8. quad: (4, 2) rough corners: top left, top right, bottom right, bottom left of the print.
        black: (n, n) 1 where a module of the marker, its border included, is black.
    """
    quad = np.asarray(quad, np.float64).reshape(4, 2)
    px_from_uv = _homography(quad)
    xy, values, block = _pixels(grey, quad, px_from_uv, len(black))
    if len(values) < 4 * len(black):
        return None
    low, high = np.percentile(values, [10, 90])
    if high - low < _LEAST_CONTRAST_DN:
        return None
    look = _Look(px_from_uv, np.zeros(2), np.full(2, np.log(_FIRST_BLUR)), 0.0, np.array([low, high - low, 0.0, 0.0]))
    bend_px = _BEND_SHARE * float(np.linalg.norm(quad[2] - quad[0])) ** 2 / 8 / max(grey.shape)
    known = np.zeros(17)
    known[8:13] = 1 / np.array([bend_px, bend_px, _BLUR_SIGMA, _BLUR_SIGMA, _TONE_SIGMA]) ** 2
    some = slice(None, None, _ROUGH_STEP)
    look = _settled(look, xy[some], values[some], black=black, known=known, rounds=_ROUGH_ROUNDS)
    look = _settled(look, xy, values, black=black, known=known, rounds=_ROUNDS)
    misfit = float(np.quantile(np.abs(_predict(look, xy, black)[0] - values), _FITTING_SHARE))
    module_px = float(np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).max()) / len(black)
    # written in this order, NaN fails too
    fits = misfit <= _MOST_MISFIT * look.levels[1] and np.abs(look.corners - quad).max() <= _MOST_MOVED * module_px
    if not fits:
        return None
    if block > 1:
        look = replace(look, least_blur=min(_LEAST_BLUR, _LEAST_BLUR_PX / module_px))
        xy, values = _edge_pixels(grey, look, black, module_px)
        look = _settled(look, xy, values, black=black, known=known, rounds=_ROUNDS)
    return look.corners


def _settled(look: _Look, xy: Array, values: Array, *, black: Array, known: Array, rounds: int) -> _Look:
    """Gauss-Newton on grey values (N,) at places (N, 2) until the corners stay, `rounds` at most."""
    for _ in range(rounds):
        predicted, jacobian = _predict(look, xy, black)
        new = look.stepped(_step(jacobian, predicted - values, known, look))
        moved_px = np.abs(new.corners - look.corners).max()
        look = new
        if not moved_px > _SETTLED_PX:
            break
    return look


def _homography(quad: Array) -> Array:
    """(3, 3) from the square of -1 ... 1 to corners (4, 2)."""
    u, v = _SQUARE.T
    zero, one = np.zeros(4), np.ones(4)
    x, y = quad.T
    across = np.stack([u, v, one, zero, zero, zero, -u * x, -v * x], axis=1)
    down = np.stack([zero, zero, zero, u, v, one, -u * y, -v * y], axis=1)
    return np.append(np.linalg.solve(np.concatenate([across, down]), np.concatenate([x, y])), 1.0).reshape(3, 3)


def _moved(matrix: Array, points: Array) -> Array:
    """Points (N, 2) through a homography (3, 3)."""
    moved = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(moved[:, :2] / moved[:, 2:])


def _pixels(grey: Array, quad: Array, px_from_uv: Array, modules: int) -> tuple[Array, Array, int]:
    """Places (N, 2) and grey values (N,) of the marker and the white around it: pixels, or means of blocks where they are many.

    The third result is the edge of a block. A block's mean knows of every edge through it; every n-th pixel would not.
    """
    reach = 1 + 2 * _MARGIN / modules
    outline = _moved(px_from_uv, reach * _SQUARE)
    first = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
    last = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, [grey.shape[1], grey.shape[0]])
    step = max(1, round(float(np.sqrt(max(np.prod(last - first), 0) / _MOST_PIXELS))))
    count = np.maximum(last - first, 0) // step
    last = first + count * step
    blocks = grey[first[1] : last[1], first[0] : last[0]].reshape(count[1], step, count[0], step).mean(axis=(1, 3))
    columns, rows = np.meshgrid(*(first[i] + step * np.arange(count[i]) + (step - 1) / 2 for i in (0, 1)))
    xy = np.stack([columns.ravel(), rows.ravel()], axis=1)
    inside = (np.abs(_moved(np.linalg.inv(px_from_uv), xy)) < reach).all(axis=1)
    return xy[inside], blocks.ravel()[inside], step


def _edge_pixels(grey: Array, look: _Look, black: Array, module_px: float) -> tuple[Array, Array]:
    """Places (N, 2) and grey values (N,) of the pixels that determine a marker's position: those next to the edges of modules.

    The mean of a block is no Gaussian blur of the pattern, which costs edges along the pixel rows a tenth of a block.
    """
    modules = len(black)
    framed = np.pad(black, 1)
    # ends (row, column) of edges along the rows of modules, and along the columns
    across = np.argwhere(framed[:-1] != framed[1:]) - [0, 1]
    along = np.argwhere(framed[:, :-1] != framed[:, 1:]) - [1, 0]
    spread = float(np.exp(look.blur.max()))
    beside = np.linspace(-1, 1, _EDGE_ACROSS) * min(max(_EDGE_PX / module_px, _EDGE_SPREADS * spread), 0.5)
    count = max(2, _EDGE_PIXELS // (_EDGE_ACROSS * (len(across) + len(along))))
    step = (np.arange(count) + 0.5) / count
    place = np.concatenate([
        _grid(across[:, 1, None] + step, across[:, 0, None] + beside),
        _grid(along[:, 1, None] + beside, along[:, 0, None] + step),
    ])  # fmt: skip
    uv = 2 * place / modules - 1
    shift = 0.75 * ((uv**2).sum(axis=1) - 2 / 3)[:, None] * look.bend
    xy = np.unique(np.rint(_moved(look.px_from_uv, uv) + shift).astype(np.int64), axis=0)
    xy = xy[((xy >= 0) & (xy < np.array(grey.shape)[::-1])).all(axis=1)]
    return xy.astype(np.float64), grey[xy[:, 1], xy[:, 0]].astype(np.float64)


def _grid(x: Array, y: Array) -> Array:
    """Points (N, 2) of all combinations of x (E, a) and y (E, b) in each row."""
    x, y = np.broadcast_arrays(x[:, :, None], y[:, None, :])
    return np.stack([x.ravel(), y.ravel()], axis=1)


def _predict(look: _Look, xy: Array, black: Array) -> tuple[Array, Array]:
    """Grey values (N,) and their change (N, 17) with all parameters."""
    modules = len(black)
    inverse = np.linalg.inv(look.px_from_uv)
    # the bend leaves the middle ring where it is and moves the corners by all of it
    share = 0.75 * ((_moved(inverse, xy) ** 2).sum(axis=1) - 2 / 3)
    flat = xy - share[:, None] * look.bend
    uv = _moved(inverse, flat)
    black_share, per_place, per_spread = _blurred(black, (uv + 1) * modules / 2, np.exp(look.blur), _askew(inverse, uv))
    white = np.clip(1 - black_share, 1e-3, 1.0)
    exponent = float(np.exp(look.tone))
    tone = white**exponent
    rise = look.levels[1] + uv @ look.levels[2:]
    per_white = rise * exponent * tone / white
    per_uv = -per_white[:, None] * per_place * modules / 2
    per_blur = -per_white[:, None] * per_spread
    jacobian = np.concatenate([
        _place_jacobian(per_uv, uv, flat, inverse, look.px_from_uv, share),
        per_blur,
        (rise * tone * np.log(white) * exponent)[:, None],
        np.ones((len(xy), 1)),
        tone[:, None],
        tone[:, None] * uv,
    ], axis=1)  # fmt: skip
    return look.levels[0] + rise * tone, jacobian


def _place_jacobian(per_uv: Array, uv: Array, flat: Array, inverse: Array, px_from_uv: Array, share: Array) -> Array:
    """(N, 10) change of grey values with the homography and the bend, given their change (N, 2) with u, v."""
    w_inverse = flat @ inverse[2, :2] + inverse[2, 2]
    per_px = (per_uv @ inverse[:2, :2] - (per_uv * uv).sum(axis=1)[:, None] * inverse[2, :2]) / w_inverse[:, None]
    w = (uv @ px_from_uv[2, :2] + px_from_uv[2, 2])[:, None]
    one = np.concatenate([uv, np.ones((len(uv), 1))], axis=1) / w
    # where the pattern moves to the right, a pixel sees what lay to its left
    tilt = (per_px * flat).sum(axis=1)[:, None] * one[:, :2]
    return np.concatenate([-per_px[:, :1] * one, -per_px[:, 1:] * one, tilt, -per_px * share[:, None]], axis=1)


def _askew(inverse: Array, uv: Array) -> Array:
    """(N,) cosine of the angle between the directions of the image in which u and v grow fastest, at places uv (N, 2)."""
    u_grows, v_grows = (inverse[i, :2] - uv[:, i, None] * inverse[2, :2] for i in (0, 1))
    return np.asarray((u_grows * v_grows).sum(axis=1) / np.linalg.norm(u_grows, axis=1) / np.linalg.norm(v_grows, axis=1))


def _blurred(black: Array, place: Array, spread: Array, askew: Array) -> tuple[Array, Array, Array]:
    """Share of black (N,) in blurred samples at places (N, 2) in modules; its derivatives (N, 2) by place and log spread.

    Blur that is as wide in all directions of the image is correlated along the sides of a marker that is seen askew, by
    `askew` (N,): Mehler's series of the bivariate normal distribution.
    """
    edges = np.diff(np.diff(np.pad(black, 1), axis=0), axis=1)
    across, down = (_steps(place[:, i], float(spread[i]), len(edges)) for i in (0, 1))
    rows, order = down @ edges, np.arange(_TERMS)[:, None]
    weight = askew**order / factorial(order)
    share, d_across, s_across, d_down, s_down = (
        weight * np.einsum("tni,tni->tn", rows[a : a + _TERMS], across[b : b + _TERMS]) for a, b in _PAIRS
    )
    per_place = np.stack([d_across.sum(axis=0), d_down.sum(axis=0)], axis=1) / spread
    per_spread = np.stack([(s_across + order * share).sum(axis=0), (s_down + order * share).sum(axis=0)], axis=1)
    return share.sum(axis=0), per_place, per_spread


def _steps(place: Array, spread: float, edges: int) -> Array:
    """(_TERMS + 2, N, edges) the normal distribution and its derivatives, at positions (N,) seen from each edge."""
    z = (place[:, None] - np.arange(edges)) / spread
    terms = np.empty((_TERMS + 2, *z.shape))
    terms[:2] = ndtr(z), np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi)
    for n in range(1, _TERMS + 1):
        terms[n + 1] = -z * terms[n] - (n - 1) * terms[n - 1]
    return terms


def _step(jacobian: Array, residual: Array, known: Array, look: _Look) -> Array:
    """Robust Gauss-Newton step (17,); a finger over the marker counts little."""
    noise_dn = float(np.hypot(_NOISE_DN, _EDGE_SHARE * look.levels[1]))
    scale = max(SIGMA_PER_MAD * float(np.median(np.abs(residual))), noise_dn)
    weight = 1 / (1 + (residual / (3 * scale)) ** 2) / scale**2
    weighted = jacobian * weight[:, None]
    offset = np.concatenate([np.zeros(8), look.bend, look.blur - np.log(_FIRST_BLUR), [look.tone], np.zeros(4)])
    normal = weighted.T @ jacobian + np.diag(known)
    size = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    scaled = normal / np.outer(size, size) + 1e-9 * np.eye(len(size))
    return -np.asarray(np.linalg.solve(scaled, (weighted.T @ residual + known * offset) / size) / size)


# of a square in the largest picture, whose sides have no more px than this
_SQUARE_PX, _MOST_PX = 480, 4000
# the board is drawn from a picture with so many px to one of the image, so many times finer than the image, and as blurred as
# a sharp image that is blurred by `_BLUR_PX`, which leaves less of its own blur
_PICTURE_FINER, _DRAWN_FINER, _DRAWN_BLUR_PX, _BLUR_PX = 2, 2, 1.2, 1.0
# what counts as around a corner: in squares; in px at least, and at most, so that a lens does not bend it
_AROUND_SHARE, _LEAST_PX, _MOST_AROUND_PX = 0.45, 4, 12
# a corner lies nearer than this to where it was read: OpenCV errs by 1 px
_MOST_MOVED_PX, _MOST_MOVED_SHARE = 1.5, 0.1
# correlation, or something else is there (a finger, glare): strong blur, noise and a tone curve leave more than 0.85
_LEAST_ALIKE = 0.8
_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-4)


class BoardFit:
    """A board, laid over images."""

    def __init__(self, target: Charuco) -> None:
        self._board, self._columns = target.board(), target.columns
        self._most_px = min(_SQUARE_PX, _MOST_PX // max(target.columns, target.rows))
        # with a square of white around it; by the px of a square
        self._pictures: dict[int, Array] = {}

    def refined(self, grey: Array, corner: Array, xy_img: Array) -> Array:
        """(n, 2) px of four or more corners (n,) that were read at xy_img (n, 2); NaN where something else is seen there.

        Corners in one line tell nothing across it: they stay as they were read.
        """
        squares = np.stack(np.divmod(corner, self._columns - 1)[::-1], axis=1) + 1.0
        px_from_squares: Array | None = cv2.findHomography(squares, xy_img)[0]
        if px_from_squares is None:
            return xy_img
        drawn_px, size_px = _laid(px_from_squares, squares)
        if not _LEAST_PX < size_px.min() <= size_px.max() < max(grey.shape):
            return xy_img
        most = 2 * size_px.max()
        low = np.maximum(np.floor(xy_img.min(axis=0) - most), 0).astype(int)
        high = np.minimum(np.ceil(xy_img.max(axis=0) + most), grey.shape[::-1]).astype(int)
        image = cv2.GaussianBlur(grey[low[1] : high[1], low[0] : high[0]].astype(np.float32), (0, 0), _BLUR_PX)
        drawing = self._drawn(px_from_squares, size_px.max(), low, high)
        moves = [
            _shift(drawing, image, at, by, px) for at, by, px in zip(drawn_px - low, xy_img - drawn_px, size_px, strict=True)
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
        """The print, a little finer than the image, and the px of its squares."""
        # few sizes are kept
        px = min(self._most_px, 2 ** int(np.ceil(np.log2(_PICTURE_FINER * square_px))))
        if px not in self._pictures:
            printed = np.round(255 * board_picture(self._board, px)).astype(np.uint8)
            self._pictures[px] = np.pad(printed, px, constant_values=255)
        return self._pictures[px], px


def _laid(px_from_squares: Array, squares: Array) -> tuple[Array, Array]:
    """Where places (n, 2) of the board lie in the image, and the root of the area (n,) of a square there."""

    def at(places: Array) -> Array:
        return np.asarray(cv2.perspectiveTransform(places[None], px_from_squares)[0])

    right, down = (at(squares + half) - at(squares - half) for half in (np.array([0.5, 0]), np.array([0, 0.5])))
    return at(squares), np.sqrt(np.abs(right[:, 0] * down[:, 1] - right[:, 1] * down[:, 0]))


def _shift(drawing: Array, image: Array, at: Array, by: Array, square_px: float) -> Array:
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
    warp, everywhere = np.column_stack([np.eye(2, dtype=np.float32), start]), np.full(seen.shape, 255, np.uint8)
    try:
        # its own filter, of one pixel here, would blur across the ends of the part
        alike, found = cv2.findTransformECC(part, seen, warp, cv2.MOTION_TRANSLATION, _STOP, everywhere, 1)
    except cv2.error:
        # it moved out of sight
        return np.full(2, np.nan)
    moved = np.asarray(found[:, 2] - (low - outer_low), float)
    return moved if alike > _LEAST_ALIKE and np.abs(moved - by).max() < most_px else np.full(2, np.nan)
