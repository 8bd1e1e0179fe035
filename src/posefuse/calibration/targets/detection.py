"""Images to observations of a target, by OpenCV, to a fraction of a pixel."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from posefuse.core import Frame, Source
from posefuse.core.arrays import Array

from .corners import CornerObservations
from .kinds import BOARD_PATCH, DICTIONARIES, Charuco, Chessboard, Markers, Target, black_modules, dictionary_of
from .pattern_fit import BoardFit, fit_marker

# a step in focus is 2 to 4 px wide; one that is wider than this is out of focus, or moved during the exposure
BLURRED_EDGE_PX = 6.0
_DIRECTIONS = np.stack([np.cos(np.arange(8) * np.pi / 8), np.sin(np.arange(8) * np.pi / 8)])
_MOVED_GREY, _LEAST_MOVING_PX, _AROUND_PX = 12, 400, 9
_PERCENTILE, _PERCENTILE_ALL = 99.8, 99.95
_EVERY, _MOST = 4, 40


def moving_pixels(before: Array, image: Array, after: Array) -> Array:
    """(H, W) bool: what differs from both the image before and the image after (three-frame difference)."""
    changed = cv2.min(cv2.absdiff(image, before), cv2.absdiff(image, after)) > _MOVED_GREY
    return np.asarray(cv2.dilate(changed.astype(np.uint8), np.ones((_AROUND_PX, _AROUND_PX), np.uint8)) > 0)


def edge_width_px(grey: Array, where: Array | None = None) -> float:
    """Contrast over the steepest edge, in the direction in which edges are widest; NaN where there is little to look at.

    Motion keeps the edges along it sharp, so edges of every direction are looked at. `where` (H, W) bool: only there.
    """
    percentile = _PERCENTILE_ALL if where is None else _PERCENTILE
    if where is None:
        where = np.ones(grey.shape, bool)
    if np.count_nonzero(where) < _LEAST_MOVING_PX:
        return float("nan")
    rows, columns = (np.flatnonzero(where.any(axis=axis)) for axis in (1, 0))
    box = (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1))
    image, inside = cv2.GaussianBlur(grey[box].astype(np.float32), (0, 0), 1.0), where[box]
    gradient = [cv2.Sobel(image, cv2.CV_32F, *order, scale=1 / 8)[inside] for order in ((1, 0), (0, 1))]
    steepest = np.percentile(np.abs(np.stack(gradient, axis=1) @ _DIRECTIONS), percentile, axis=0)
    low, high = np.percentile(image[inside], [0.5, 99.5])
    return float((high - low) / max(float(steepest.min()), 1e-3))


def usual_edge_width_px(images: Sequence[Array]) -> float:
    """Median over consecutive grey images of the width of moving edges; of all edges where nothing moves."""
    moving = MovingEdges(every=1)
    for image in images:
        moving.add(image)
    return moving.width_px if moving.widths_px else float(np.median([edge_width_px(image) for image in images] or [np.nan]))


class MovingEdges:
    """Width of the edges of what moves, over the frames of one camera as they come; a sample of them is measured."""

    def __init__(self, every: int = _EVERY) -> None:
        self.widths_px: list[float] = []
        self._every, self._count, self._last = every, 0, list[Array]()

    def add(self, grey: Array) -> None:
        """The next frame."""
        self._last = [*self._last[-2:], grey]
        self._count += 1
        if len(self._last) == 3 and self._count % self._every == 0 and len(self.widths_px) < _MOST:
            width = edge_width_px(self._last[1], moving_pixels(*self._last))
            self.widths_px += [width] if np.isfinite(width) else []

    @property
    def width_px(self) -> float:
        """Median; NaN where nothing moved."""
        return float(np.median(self.widths_px)) if self.widths_px else float("nan")


_REFINE_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-3)
_MIN_CHARUCO_CORNERS = 4
# a wrong grid is off by whole squares, the bend of a lens by less than this share of one
_MOST_UNEVEN_SHARE = 0.25


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of a target in one image.

    Attributes:
        patch, corner: (n,) numbers. xy_img: (n, 2) px.
        doubled: marker ids met twice and left out.
    """

    patch: Array
    corner: Array
    xy_img: Array
    doubled: tuple[int, ...] = ()


class TargetDetector:
    """Finds one target in grey images."""

    def __init__(self, target: Target) -> None:
        self.target = target
        self._find: Callable[[Array], Corners] = _finder(target)
        self._inverted = getattr(target, "inverted", False)

    def detect(self, grey: Array) -> Corners:
        """Corners in a grey uint8 image (H, W); empty when the target is not in it."""
        return self._find(255 - grey if self._inverted else grey)


def detect_corners(source: Source, target: Target, every: int = 1) -> CornerObservations:
    """Look for a target in every `every`-th frame of one camera."""
    detector = TargetDetector(target)
    return corners_from_frames(source.camera, source.size_wh, source.frames(), detector, every)


def corners_from_frames(
    camera: str, size_wh: tuple[int, int], frames: Iterable[Frame], detector: TargetDetector, every: int = 1
) -> CornerObservations:
    """Corners of every `every`-th frame of one camera."""
    rows: list[tuple[Array, Corners]] = []
    doubled: Counter[int] = Counter()
    count, edges = 0, MovingEdges()
    for i, frame in enumerate(frames):
        if i % every:
            continue
        count += 1
        grey = cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY)
        edges.add(grey)
        found = detector.detect(grey)
        doubled.update(found.doubled)
        if len(found.xy_img):
            rows.append((np.full(len(found.xy_img), frame.t_ns), found))
    return CornerObservations(
        cameras=(camera,),
        sizes_wh=(size_wh,),
        frame_count=(count,),
        camera=np.zeros(sum(len(t) for t, _ in rows), np.int64),
        t_ns=_concatenated([t for t, _ in rows]),
        patch=_concatenated([found.patch for _, found in rows]),
        corner=_concatenated([found.corner for _, found in rows]),
        xy_img=_concatenated([found.xy_img for _, found in rows]).reshape(-1, 2),
        doubled=tuple((camera, int(patch), number) for patch, number in sorted(doubled.items())),
        edge_width_px=((camera, edges.width_px),),
    )


def why_nothing(grey_images: Sequence[Array], target: Target, edge_width_px: float = 0.0) -> str:
    """The likely reason why a target was found in none of these images, in words.

    `edge_width_px`: usual width of moving edges in the whole recording, as `CornerObservations` has it.
    """
    if _found_in(grey_images, TargetDetector(target), lambda image: cv2.flip(image, 1)):
        return "it is there when the image is mirrored: switch the mirror mode of the camera off"
    if isinstance(target, Chessboard):
        return (
            f"no chessboard of {target.columns} x {target.rows} inner corners is wholly inside the image: too small, blurred, cut"
            " off, without a white margin, or has it another number of inner corners?"
        )
    if wrong := _wrong_file(grey_images, target):
        return wrong
    width_px = float(np.nanmax([edge_width_px, usual_edge_width_px(grey_images)]))
    if width_px > BLURRED_EDGE_PX:
        return f"the images are blurred, edges are {width_px:.0f} px wide: focus, shorten the exposure, add light"
    return "no marker of any known dictionary is there: too small, blurred, cut off or badly lit?"


def _wrong_file(grey_images: Sequence[Array], target: Markers | Charuco) -> str:
    """What the target file states that is not in the images, which show a target; empty where they show none."""
    if _found_in(grey_images, TargetDetector(target), lambda image: 255 - image):
        return "it is there with colours exchanged: set or clear `inverted`"
    if isinstance(target, Charuco):
        turned = replace(target, columns=target.rows, rows=target.columns)
        if _found_in(grey_images, TargetDetector(turned), None):
            return f"it is there with columns = {turned.columns}, rows = {turned.rows}"
        if _found_in(grey_images, TargetDetector(replace(target, legacy=not target.legacy)), None):
            return f"it is there with legacy = {not target.legacy}"
    # its own first: larger dictionaries of the same size begin with the same markers
    for name in sorted(DICTIONARIES, key=lambda name: name != target.dictionary):
        ids = _ids_in(grey_images, name)
        if ids:
            known = (
                f"markers of {name} are there (ids {', '.join(map(str, ids[:8]))}), the target file states {target.dictionary}"
            )
            return known if name != target.dictionary else _other_ids(ids, target)
    return ""


def _other_ids(ids: list[int], target: Target) -> str:
    there = f"markers {', '.join(map(str, ids[:8]))} of its dictionary are there"
    if isinstance(target, Markers) and target.ids and not set(ids) & set(target.ids):
        return f"{there}, the target has ids {', '.join(map(str, target.ids))}"
    return f"{there}, but not as described" + (": count columns and rows" if isinstance(target, Charuco) else "")


def _found_in(grey_images: Sequence[Array], detector: TargetDetector, change: Callable[[Array], Array] | None) -> bool:
    return any(len(detector.detect(change(image) if change else image).xy_img) for image in grey_images)


def _ids_in(grey_images: Sequence[Array], dictionary: str) -> list[int]:
    detector = cv2.aruco.ArucoDetector(dictionary_of(dictionary))
    found = Counter(int(i) for image in grey_images for i in np.ravel(_or_empty(detector.detectMarkers(image)[1])))
    return sorted(i for i, times in found.items() if times >= max(1, len(grey_images) // 4))


def _or_empty(ids: Any) -> Array:
    return np.zeros(0, np.int64) if ids is None else np.asarray(ids)


def _concatenated(parts: list[Array]) -> Array:
    return np.concatenate(parts) if parts else np.zeros(0)


def _finder(target: Target) -> Callable[[Array], Corners]:
    match target:
        case Markers():
            return _marker_finder(target)
        case Charuco():
            return _charuco_finder(target)
        case Chessboard():
            return lambda grey: _chessboard(grey, target)


def _parameters() -> Any:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    return parameters


def _markers(grey: Array, detector: Any) -> tuple[Array, Array, tuple[int, ...]]:
    """Ids (n,) and corners (n, 4, 2) of the markers in an image whose pattern fits, and the ids that came twice."""
    quads, ids, _ = detector.detectMarkers(grey)
    ids = _or_empty(ids).ravel().astype(np.int64)
    if len(ids) == 0:
        return ids, np.zeros((0, 4, 2)), ()
    xy = np.asarray(quads, np.float32).reshape(-1, 4, 2)
    counts = Counter(ids.tolist())
    once = np.array([counts[i] == 1 for i in ids.tolist()])
    twice = tuple(sorted(i for i, times in counts.items() if times > 1))
    dictionary = detector.getDictionary()
    fitted = [
        fit_marker(grey, quad, black_modules(dictionary, i).astype(float))
        for i, quad in zip(ids[once].tolist(), xy[once], strict=True)
    ]
    fits = np.array([corners is not None for corners in fitted], bool)
    return ids[once][fits], np.array([corners for corners in fitted if corners is not None]).reshape(-1, 4, 2), twice


def _marker_finder(target: Markers) -> Callable[[Array], Corners]:
    detector = cv2.aruco.ArucoDetector(dictionary_of(target.dictionary), _parameters())

    def find(grey: Array) -> Corners:
        ids, xy, twice = _markers(grey, detector)
        mine = np.isin(ids, target.ids) if target.ids else np.ones(len(ids), bool)
        twice = tuple(i for i in twice if not target.ids or i in target.ids)
        ids, xy = ids[mine], xy[mine]
        return Corners(np.repeat(ids, 4), np.tile(np.arange(4), len(ids)), xy.reshape(-1, 2), twice)

    return find


def _charuco_finder(target: Charuco) -> Callable[[Array], Corners]:
    detector, fit = cv2.aruco.CharucoDetector(target.board()), BoardFit(target)
    return lambda grey: _charuco(grey, detector, fit)


def _charuco(grey: Array, detector: Any, fit: BoardFit) -> Corners:
    read, ids, _, _ = detector.detectBoard(grey)
    ids, xy = _or_empty(ids).ravel().astype(np.int64), np.asarray(_or_empty(read), np.float64).reshape(-1, 2)
    if len(ids) >= _MIN_CHARUCO_CORNERS:
        xy = fit.refined(grey, ids, xy)
        ids, xy = ids[np.isfinite(xy[:, 0])], xy[np.isfinite(xy[:, 0])]
    kept = len(ids) if len(ids) >= _MIN_CHARUCO_CORNERS else 0
    return Corners(np.full(kept, BOARD_PATCH), ids[:kept], xy[:kept])


def _chessboard(grey: Array, target: Chessboard) -> Corners:
    grid = _chessboard_grid(grey, target)
    if grid is None:
        return Corners(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)))
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if across[0] * down[1] - across[1] * down[0] < 0:
        # read from its other end, so that the printed face looks at the camera
        grid = grid[:, ::-1]
    count = target.columns * target.rows
    return Corners(np.full(count, BOARD_PATCH), np.arange(count), grid.reshape(-1, 2))


def _chessboard_grid(grey: Array, target: Chessboard) -> Array | None:
    """Inner corners (rows, columns, 2), or None.

    The sector method measures best (0.15 px where the classical one leaves 0.6 px on large squares). Its exhaustive
    search takes a second per image, so it is only spent where the quick classical search saw a board.
    """
    size = (target.columns, target.rows)
    accurate = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    grid = _flat_grid(cv2.findChessboardCornersSB(grey, size, flags=accurate), target)
    if grid is not None:
        return grid
    quick = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    rough = cv2.findChessboardCorners(grey, size, flags=quick)
    if not rough[0]:
        return None
    grid = _flat_grid(cv2.findChessboardCornersSB(grey, size, flags=accurate | cv2.CALIB_CB_EXHAUSTIVE), target)
    coarse = _flat_grid(rough, target)
    if grid is not None or coarse is None:
        return grid
    half = int(np.clip(_square_px(coarse) / 4, 2, 15))
    refined = cv2.cornerSubPix(grey, rough[1].copy(), (half, half), (-1, -1), _REFINE_STOP)
    return _flat_grid((True, refined), target)


def _flat_grid(answer: tuple[bool, Array], target: Chessboard) -> Array | None:
    """The corners (rows, columns, 2) of OpenCV's answer, unless they cannot be the image of a flat board."""
    found, xy = answer
    if not found:
        return None
    points = np.asarray(xy, np.float64).reshape(-1, 2)
    # None for degenerate corners, which the stubs of OpenCV leave out
    homography: Array | None = cv2.findHomography(target.corners(BOARD_PATCH)[:, :2], points)[0]
    if homography is None:
        return None
    flat = cv2.perspectiveTransform(target.corners(BOARD_PATCH)[None, :, :2], homography)[0]
    grid = points.reshape(target.rows, target.columns, 2)
    off_px = float(np.sqrt(((flat - points) ** 2).sum(axis=-1).mean()))
    return grid if off_px < _MOST_UNEVEN_SHARE * _square_px(grid) else None


def _square_px(grid: Array) -> float:
    """Smallest edge of a square along the rows."""
    return float(np.linalg.norm(np.diff(grid, axis=1), axis=-1).min())
