"""How a skeleton looks in an image: colours by side, one tile per camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from posefuse.core import Kind, Recording, Skeleton
from posefuse.core.arrays import Array, frozen
from posefuse.core.palette import LEFT, MIDDLE, PEOPLE, RIGHT, colour_of

DETECTION_RGB = (255, 255, 255)
NOTE_RGB = (255, 230, 80)
ALARM_RGB = (255, 80, 70)
EMPTY_RGB = (38, 40, 46)
# sixteenths of a pixel in OpenCV's drawing calls
_SHIFT = 4
_FAR_PX = 30_000
_FONT_PX = 22.0
# two lines, their two ends, in lengths of an arm
_CROSS = np.array([[[-1, 0], [1, 0]], [[0, -1], [0, 1]]], np.int32)


def keypoint_colours(skeleton: Skeleton) -> list[tuple[int, int, int]]:
    """RGB per keypoint: the subject's left orange, right blue, midline green (`core.palette`)."""
    return [colour_of(name).image_rgb for name in skeleton.keypoints]


def bone_colours(skeleton: Skeleton) -> list[tuple[int, int, int]]:
    """RGB per bone: that of its side; bones across are green."""
    colours = keypoint_colours(skeleton)
    ends = skeleton.bone_indices.tolist()
    return [colours[a] if colours[a] == colours[b] else _mixed(colours[a], colours[b]) for a, b in ends]


def _mixed(a: tuple[int, int, int], b: tuple[int, int, int]) -> tuple[int, int, int]:
    sides = {a, b} - {MIDDLE.image_rgb}
    return sides.pop() if len(sides) == 1 else MIDDLE.image_rgb


@dataclass(frozen=True)
class Grid:
    """Equal tiles in rows that hold one image each, whole and undistorted in shape.

    Attributes:
        columns: tiles per row. tile_wh: px, even. size_wh: of the whole image, px.
    """

    columns: int
    tile_wh: tuple[int, int]
    size_wh: tuple[int, int]

    def corner(self, place: int) -> tuple[int, int]:
        """(left, top) px of a tile."""
        return (place % self.columns) * self.tile_wh[0], (place // self.columns) * self.tile_wh[1]


def grid_for(sizes_wh: list[tuple[int, int]], most_wh: tuple[int, int]) -> Grid:
    """The arrangement inside `most_wh` px that shows images of these sizes largest, never enlarged."""
    width, height = max(w for w, _ in sizes_wh), max(h for _, h in sizes_wh)
    count = len(sizes_wh)
    best_scale, best_columns = 0.0, 1
    for columns in range(1, count + 1):
        rows = -(-count // columns)
        scale = min(most_wh[0] / columns / width, most_wh[1] / rows / height, 1.0)
        if scale > best_scale:
            best_scale, best_columns = scale, columns
    tile = (max(2, int(width * best_scale) // 2 * 2), max(2, int(height * best_scale) // 2 * 2))
    rows = -(-count // best_columns)
    return Grid(best_columns, tile, (tile[0] * best_columns, tile[1] * rows))


def image_tile(image: Array | None, size_wh: tuple[int, int], tile_wh: tuple[int, int]) -> tuple[Array, float]:
    """A tile (H, W, 3) with the image in its top left corner, as large as fits, and the scale; a plain one without image."""
    tile = np.empty((tile_wh[1], tile_wh[0], 3), np.uint8)
    return tile, fit_into(tile, image, size_wh)


def fit_into(tile: Array, image: Array | None, size_wh: tuple[int, int]) -> float:
    """Fill a tile (H, W, 3), which may be part of a larger image, as `image_tile` does; returns the scale."""
    import cv2

    tile_wh: tuple[int, int] = (tile.shape[1], tile.shape[0])
    scale = min(tile_wh[0] / size_wh[0], tile_wh[1] / size_wh[1])
    if image is not None and size_wh == tile_wh:
        tile[:] = image
        return scale
    tile[:] = empty_row(tile_wh[0])
    if image is not None:
        width, height = min(tile_wh[0], round(size_wh[0] * scale)), min(tile_wh[1], round(size_wh[1] * scale))
        tile[:height, :width] = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return scale


@lru_cache(maxsize=16)
def empty_row(width: int) -> Array:
    """(W, 3) a line of plain ground: an image is filled with lines in a tenth of the time that single pixels take."""
    return frozen(np.full((width, 3), EMPTY_RGB), np.uint8, "empty_row")


def draw_skeleton(tile: Array, xy: Array, kind: Array, skeleton: Skeleton) -> None:
    """Draw one person (K, 2) px, NaN where missing; what is not measured (interpolated, predicted) is drawn hollow and thin."""
    import cv2

    thick = max(1, round(tile.shape[0] / 260))
    measured = (kind == Kind.FUSED) | (kind == Kind.SMOOTHED)
    good, fixed = _fixed(xy)
    places, known, sure = fixed.tolist(), good.tolist(), measured.tolist()
    of_keypoints, bones = _coloured(skeleton)
    for a, b, colour in bones:
        if known[a] and known[b]:
            cv2.line(tile, places[a], places[b], colour, thick + 1 if sure[a] and sure[b] else 1, cv2.LINE_AA, _SHIFT)
    radius = round((thick + 1.5) * 2**_SHIFT)
    for k, colour in enumerate(of_keypoints):
        if known[k]:
            cv2.circle(tile, places[k], radius, colour, -1 if sure[k] else 1, cv2.LINE_AA, _SHIFT)


@lru_cache(maxsize=16)
def _coloured(skeleton: Skeleton) -> tuple[Sequence[tuple[int, int, int]], Sequence[tuple[int, int, tuple[int, int, int]]]]:
    """Colours of the keypoints; ends and colour of each bone."""
    ends = skeleton.bone_indices.tolist()
    return keypoint_colours(skeleton), [(a, b, rgb) for (a, b), rgb in zip(ends, bone_colours(skeleton), strict=True)]


def draw_detections(tile: Array, xy: Array, score: Array) -> None:
    """Draw raw 2D keypoints (K, 2) px of one view as small crosses; those with score 0 are not there."""
    import cv2

    arm = int(max(2.0, tile.shape[0] / 240) * 2**_SHIFT)
    good, fixed = _fixed(xy)
    # (marks * 2, 2, 2): two lines of two ends each
    lines = fixed[good & (score > 0), None, None] + arm * _CROSS
    cv2.polylines(tile, list(lines.reshape(-1, 2, 2)), False, DETECTION_RGB, 1, cv2.LINE_AA, _SHIFT)


def draw_text(tile: Array, text: str, line: int, colour: tuple[int, int, int] = DETECTION_RGB) -> None:
    """Write a line of text at the top left, on a dark ground."""
    import cv2

    scale = max(0.35, min(tile.shape[0] / 640, tile.shape[1] / 420, 1.0) * 0.7)
    height = round(_FONT_PX * scale / 0.7)
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
    top = line * height
    ground = tile[top : top + height, : width + 12]
    ground[:] = ground // 3
    cv2.putText(tile, text, (6, top + round(height * 0.75)), cv2.FONT_HERSHEY_SIMPLEX, scale, colour, 1, cv2.LINE_AA)


def draw_legend(tile: Array, line: int) -> None:
    """Write which side has which colour, on two lines."""
    draw_text(tile, "left", line, LEFT.image_rgb)
    draw_text(tile, "right", line + 1, RIGHT.image_rgb)


def draw_name(tile: Array, xy: Array, recording: Recording, n: int) -> None:
    """Write who person n is above keypoints (K, 2) of the tile; nothing where there is one person without a name."""
    import cv2

    name, person = recording.person_names[n], int(recording.poses.person_id[n])
    seen = xy[np.isfinite(xy).all(axis=-1)]
    if not len(seen) or (len(recording.poses.person_id) == 1 and name == f"person {person}"):
        return
    top = seen[seen[:, 1].argmin()]
    scale = float(np.clip(tile.shape[0] / 900, 0.4, 0.7))
    # before version 5, OpenCV's fonts have no other letters
    shown = name if name.isascii() or int(cv2.__version__.split(".")[0]) >= 5 else f"person {person}"
    (width, height), below = cv2.getTextSize(shown, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)
    left = int(np.clip(top[0] - width / 2, 2, max(tile.shape[1] - width - 2, 2)))
    line = int(np.clip(top[1] - 8, height + 2, max(tile.shape[0] - below, height + 2)))
    ground = tile[line - height - 2 : line + below, left - 2 : left + width + 2]
    ground[:] = ground // 3
    cv2.putText(tile, shown, (left, line), cv2.FONT_HERSHEY_SIMPLEX, scale, person_rgb(person), 1, cv2.LINE_AA)


def person_rgb(person: int) -> tuple[int, int, int]:
    """The colour of a person's name, by id."""
    return PEOPLE[person % len(PEOPLE)]


def view_tile(
    recording: Recording,
    i: int,
    c: int,
    image: Array | None,
    tile_wh: tuple[int, int],
    *,
    notes: bool = True,
) -> Array:
    """Camera c at time step i: its image, the fused skeleton re-projected, the raw detections, and what is missing.

    Args:
        notes: write camera, time and what is missing into the corner.
    """
    tile = np.empty((tile_wh[1], tile_wh[0], 3), np.uint8)
    draw_view(tile, recording, i, c, image, notes=notes)
    return tile


def draw_view(
    tile: Array,
    recording: Recording,
    i: int,
    c: int,
    image: Array | None,
    *,
    notes: bool = True,
) -> None:
    """`view_tile` into a tile (H, W, 3) that may be part of a larger image."""
    camera, poses = recording.rig.cameras[c], recording.poses
    size_wh = camera.size_wh if image is None else (image.shape[1], image.shape[0])
    scale = fit_into(tile, image, size_wh)
    words = [] if image is not None else ["no frame"]
    # pixel centres are integers: the corner of the image is at -0.5
    projected = (camera.project(poses.xyz_world[i]) + 0.5) * scale - 0.5
    for n in range(len(poses.person_id)):
        draw_skeleton(tile, projected[n], poses.kind[i, n], poses.skeleton)
        draw_detections(tile, (recording.views.xy_img[i, n, c] + 0.5) * scale - 0.5, recording.views.score[i, n, c])
    for n in range(len(poses.person_id)):
        draw_name(tile, projected[n], recording, n)
    if not notes:
        return
    # live, cameras are looked at in turn: at most times an image was not
    if not recording.is_live and not (recording.views.score[i, :, c] > 0).any():
        words.append("no person seen")
    gone = int((poses.kind[i] == Kind.MISSING).sum())
    if gone:
        words.append(f"{gone} of {poses.kind[i].size} keypoints missing")
    draw_text(tile, f"{camera.name}  {poses.t_ns[i] / 1e9:.3f} s", 0)
    for line, word in enumerate(words):
        draw_text(tile, word, line + 1, ALARM_RGB if word != words[-1] or not gone else NOTE_RGB)


def draw_views(picture: Array, grid: Grid, recording: Recording, i: int, images: Sequence[Array | None]) -> None:
    """Every camera's view at time step i into its tile of an image (H, W, 3); None where it has none."""
    width, height = grid.tile_wh
    for c, image in enumerate(images):
        left, top = grid.corner(c)
        draw_view(picture[top : top + height, left : left + width], recording, i, c, image)


def shrunk_wh(size_wh: tuple[int, int], longest_px: int) -> tuple[int, int]:
    """The size of an image whose longer side is made at most so long."""
    factor = min(1.0, longest_px / max(size_wh))
    return max(1, round(size_wh[0] * factor)), max(1, round(size_wh[1] * factor))


def shrunk(image: Array, longest_px: int) -> Array:
    """An RGB image (H, W, 3) with a longer side of at most so many px, each the mean of those that it stands for."""
    import cv2

    size_wh = shrunk_wh((image.shape[1], image.shape[0]), longest_px)
    return np.asarray(cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA))


def jpeg_of(image: Array, quality: int = 75) -> bytes:
    """An RGB image (H, W, 3) as JPEG; quality 1 to 100."""
    import cv2

    _, encoded = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return encoded.tobytes()


def _fixed(xy: Array) -> tuple[Array, Array]:
    """Which points (K, 2) can be drawn, (K,), and OpenCV's fixed-point coordinates (K, 2) of those.

    Those far outside the image would overflow.
    """
    good = np.asarray((np.abs(xy) < _FAR_PX).all(axis=-1))
    return good, np.asarray(np.round(np.where(good[:, None], xy, 0.0) * 2**_SHIFT), np.int32)
