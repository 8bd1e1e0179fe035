"""People of coloured discs, one colour per keypoint, and networks that find them."""

from pathlib import Path

import cv2
import graphs
import numpy as np
from built import of_sides

from posefuse.core import SKELETONS, Rig

SKELETON = SKELETONS["coco17"]
# the bright faces of the colour cube: a disc's rim, where it blends with the black background, is no other disc's colour
_VALUES = (0, 127, 255)
COLOURS = np.array([(r, g, b) for r in _VALUES for g in _VALUES for b in _VALUES if max(r, g, b) == 255][:17], float)
# of a network with its own range per channel; one width for all, so that colours keep their distances
MEAN, STD = np.array([30.0, 40.0, 50.0]), 50.0
REACH = 30.0 / STD
RATE_HZ, FRAMES, DISC_PX = 25.0, 16, 3.0
LEFT = {
    "eye": (0.06, 0.08, 1.70), "ear": (-0.04, 0.12, 1.64), "shoulder": (0, 0.20, 1.42), "elbow": (0.08, 0.45, 1.30),
    "wrist": (0.2, 0.62, 1.12), "hip": (0, 0.14, 0.92), "knee": (0.06, 0.17, 0.5), "ankle": (-0.04, 0.2, 0.09),
}  # fmt: skip


def true_xyz(turned_rad: float = 0.0) -> np.ndarray:
    """(T, K, 3): a person who glides and turns, beginning at an angle."""
    rest = of_sides(SKELETON, LEFT, nose=(0.10, 0, 1.62))
    t = np.arange(FRAMES) / RATE_HZ
    turn = turned_rad + 0.6 * t
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.stack([np.stack([c, -s, 0 * c], -1), np.stack([s, c, 0 * c], -1), np.stack([0 * c, 0 * c, 1 + 0 * c], -1)], -2)
    return np.einsum("tij,kj->tki", rotation, rest) + np.stack([0.5 * t - 0.2, 0.1 * t, 0 * t], -1)[:, None]


def draw(rig: Rig, xyz: np.ndarray, folder: Path) -> None:
    """A folder of images per camera, near discs over far ones."""
    for camera in rig:
        place = folder / camera.name
        place.mkdir(parents=True)
        depth = (camera.cam_from_world @ xyz)[..., 2]
        for i, xy in enumerate(camera.project(xyz)):
            image = np.zeros((camera.size_wh[1], camera.size_wh[0], 3), np.uint8)
            for k in np.argsort(-depth[i]):
                at = tuple(np.rint(xy[k] * 64).astype(int).tolist())
                cv2.circle(image, at, round(DISC_PX * 64), COLOURS[k][::-1].tolist(), -1, cv2.LINE_AA, 6)
            cv2.imwrite(str(place / f"{i:06d}.png"), image)


def card_of(kind: str, folder: Path) -> Path:
    """A network that finds the discs, with its card and, where it needs one, that of a person detector."""
    normalised = (COLOURS - MEAN) / STD
    rest = f"mean = {MEAN.tolist()}\nstd = [{STD}, {STD}, {STD}]\nfill = 0\n"
    top = 'keypoints = "coco17"\npersons = "persons.toml"'
    persons = graphs.bright_person(folder / "persons.onnx", (320, 256), 60.0)
    graphs.write_card(folder / "persons.toml", "detections", persons, (320, 256), rest="fill = 0\n")
    path = folder / f"{kind}.onnx"
    if kind == "synthpose":
        # each disc stands for several of its keypoints
        size, top = (192, 256), top.replace("coco17", "synthpose_52")
        network = graphs.colour_heatmaps(path, size, np.resize(normalised, (len(SKELETONS["synthpose_52"]), 3)), REACH)
    elif kind in ("simcc", "heatmap"):
        size = (192, 256)
        build = graphs.colour_simcc if kind == "simcc" else graphs.colour_heatmaps
        network = build(path, size, normalised, REACH)
    else:
        size = (640, 480)
        network = graphs.colour_one_stage(path, size, normalised, REACH, kind)
        if kind == "yolo_pose":
            rest += 'letterbox = "centre"\n'
    layout = "heatmap" if kind == "synthpose" else kind
    return graphs.write_card(folder / f"{kind}.toml", layout, network, size, top, rest)
