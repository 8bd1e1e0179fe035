"""Images of a tracked session: what a camera saw, with the estimate, and with the truth next to it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posefuse.core import PAPER14, Array, Camera, Skeleton, pick_keypoints
from posefuse.evaluation import true_xyz_at
from posefuse.pipeline import build_source, find_session

from .runs import Run

ESTIMATE_RGB, TRUTH_RGB = (40, 120, 255), (235, 40, 40)
# room around the person, in its own size; a frame that close to its time step is that time step's
_ROOM, _SAME_NS = 1.6, 1_000_000
_LINE_PX = 2
# sixteenths of a pixel in OpenCV's drawing calls
_SHIFT = 4
_LIMBS = tuple((f"{side}_{a}", f"{side}_{b}") for side in ("left", "right") for a, b in
               (("shoulder", "elbow"), ("elbow", "wrist"), ("shoulder", "hip"), ("hip", "knee"), ("knee", "ankle")))  # fmt: skip
_BONES = (*_LIMBS, ("left_shoulder", "right_shoulder"), ("left_hip", "right_hip"))


def pictures(run: Run, camera: int, instants: Sequence[int], width_px: int = 480) -> dict[str, Array]:
    """Captions to images of one camera at time steps of the recording, with the fused skeleton drawn in."""
    from posefuse.outputs import view_tile

    width, height = run.recording.rig.cameras[camera].size_wh
    tile_wh = (width_px, round(width_px * height / width))
    return {
        _caption(run, camera, i): view_tile(run.recording, i, camera, image, tile_wh)
        for i, image in images_at(run, camera, instants).items()
    }


def moments(run: Run, camera: int, instants: Sequence[int], side_px: int = 420) -> dict[str, Array]:
    """Captions to square images cut out around the person, with its true skeleton in red and the estimate in blue."""
    poses = run.recording.poses
    placed = run.recording.rig.cameras[camera]
    found = {}
    for i, image in images_at(run, camera, instants).items():
        true_xy = _projected(placed, true_xyz_at(run.truth, poses.t_ns[i : i + 1])[0, 0], run.truth.skeleton)
        xy = _projected(placed, poses.xyz_world[i, 0], poses.skeleton)
        found[_caption(run, camera, i)] = _cut_out(image, {TRUTH_RGB: true_xy, ESTIMATE_RGB: xy}, side_px)
    return found


def images_at(run: Run, camera: int, instants: Sequence[int]) -> dict[int, Array]:
    """What a camera saw at time steps of the recording, in their order."""
    name = run.recording.rig.names[camera]
    entry = next(entry for entry in find_session(run.folder, run.config).inputs if entry.camera == name)
    source = build_source(entry, run.config)
    wanted = {int(i): run.recording.poses.t_ns[i] for i in instants}
    images: dict[int, Array] = {}
    try:
        for frame in source.frames():
            for i, t_ns in wanted.items():
                if i not in images and frame.t_ns >= t_ns - _SAME_NS:
                    images[i] = np.array(frame.image)
            if len(images) == len(wanted):
                break
    finally:
        source.close()
    return dict(sorted(images.items()))


def _caption(run: Run, camera: int, i: int) -> str:
    return f"{run.recording.rig.names[camera]}, {run.recording.poses.t_ns[i] / 1e9:.2f} s"


def _projected(camera: Camera, xyz_world: Array, skeleton: Skeleton) -> Array:
    """(14, 2) px of the paper's joints."""
    return camera.project(pick_keypoints(xyz_world[None], skeleton, PAPER14.keypoints)[0])


def _cut_out(image: Array, figures: dict[tuple[int, int, int], Array], side_px: int) -> Array:
    """The square around the figures (14, 2), and their limbs drawn in."""
    import cv2

    known = np.concatenate([xy[np.isfinite(xy).all(axis=-1)] for xy in figures.values()])
    low, high = known.min(axis=0), known.max(axis=0)
    scale = side_px / (_ROOM * float((high - low).max()))
    corner = (low + high) / 2 - side_px / scale / 2
    moved = np.array([[scale, 0, -scale * corner[0]], [0, scale, -scale * corner[1]]])
    tile = np.asarray(cv2.warpAffine(image, moved, (side_px, side_px), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
    for colour, xy in figures.items():
        here = (xy - corner) * scale
        for ends in PAPER14.indices([joint for bone in _BONES for joint in bone]).reshape(-1, 2):
            if np.isfinite(here[ends]).all():
                (x0, y0), (x1, y1) = np.round(here[ends] * 2**_SHIFT).astype(int).tolist()
                cv2.line(tile, (x0, y0), (x1, y1), colour, _LINE_PX, cv2.LINE_AA, _SHIFT)
    return tile
