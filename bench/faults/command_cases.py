"""Faults that only images and files show: rendered markers through the command line."""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from posefuse.calibration.targets.kinds import Markers, dictionary_of, write_target
from posefuse.cli.command_line import parse
from posefuse.cli.terminal import Terminal
from posefuse.core import CalibrationError, Camera, Rig
from posefuse.core.arrays import Array
from posefuse.formats.rig import read_rig, write_rig

from .sessions import errors, ring
from .verdict import GOOD, Answer, Case
from .waved_props import Waving, cube

_WRONG = 1e6
SIDE_M, EDGE_M, RATE_HZ, SECONDS = 0.28, 0.36, 8.0, 7.0
_GREY, _QUIET, _CELL_PX = 150, 1, 24


@dataclass(frozen=True)
class Look:
    """How the images are made.

    Attributes:
        exposure_s: the prop moves on meanwhile. mirrored: cameras whose images are flipped. inverted: print.
        blurred: cameras that are out of focus, by `focus_px`. dictionary: of the print.
    """

    exposure_s: float = 0.0
    mirrored: tuple[int, ...] = ()
    inverted: bool = False
    blurred: tuple[int, ...] = ()
    focus_px: float = 6.0
    dictionary: str = "DICT_4X4_50"


class _Recorded(Terminal):
    """A terminal that keeps its lines."""

    def __init__(self) -> None:
        super().__init__(as_json=True)
        self.words: list[str] = []

    def note(self, text: str) -> None:
        self.words.append(text)

    def warn(self, text: str) -> None:
        self.words.append(f"warning: {text}")


def room(seed: int) -> Rig:
    """Three cameras near each other, without distortion, since the markers are drawn by homographies."""
    rig = ring(8, seed, radius_m=2.6)
    picked = (replace(rig.cameras[i], name=f"cam{i:02d}", distortion=np.zeros(0)) for i in range(3))
    return Rig(tuple(picked), world_set_by="truth")


def render(camera: Camera, t_s: float, motion: Waving, look: Look) -> Array:
    """Grey image (H, W) of the cube of markers."""
    moments = t_s + np.linspace(0.0, look.exposure_s, 6 if look.exposure_s else 1)
    return np.asarray(np.mean([_moment(camera, t, motion, look) for t in moments], axis=0).astype(np.uint8))


def _moment(camera: Camera, t_s: float, motion: Waving, look: Look) -> Array:
    width, height = (2 * side for side in camera.size_wh)
    image = np.full((height, width), _GREY, np.uint8)
    world_from_prop = motion.pose(np.array([t_s]))[0]
    dictionary = dictionary_of(look.dictionary)
    for marker, prop_from_marker in cube(EDGE_M).items():
        world_from_marker = world_from_prop @ prop_from_marker
        if (camera.centre_world - world_from_marker.xyz) @ world_from_marker.matrix()[:, 2] <= 0:
            continue
        modules = dictionary.markerSize + 2 + 2 * _QUIET
        sheet = np.full((modules * _CELL_PX,) * 2, 255, np.uint8)
        inner = slice(_QUIET * _CELL_PX, -_QUIET * _CELL_PX)
        sheet[inner, inner] = dictionary.generateImageMarker(marker, (modules - 2 * _QUIET) * _CELL_PX)
        half = SIDE_M / 2 * modules / (modules - 2 * _QUIET)
        corners = half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0.0]])
        xy = camera.project(world_from_marker @ corners)
        if not np.isfinite(xy).all():
            continue
        side = modules * _CELL_PX
        source = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32) - 0.5
        warp = cv2.getPerspectiveTransform(source, (2 * xy + 0.5).astype(np.float32))
        drawn = cv2.warpPerspective(255 - sheet if look.inverted else sheet, warp, (width, height), flags=cv2.INTER_AREA)
        mask = cv2.warpPerspective(np.full_like(sheet, 255), warp, (width, height)) > 127
        image[mask] = drawn[mask]
    return cv2.resize(image, camera.size_wh, interpolation=cv2.INTER_AREA)


def _motion(seed: int) -> Waving:
    return Waving(seconds=SECONDS, rate_hz=RATE_HZ, seed=seed, reach_m=(0.6, 0.6, 0.4), swings_hz=0.12)


def _film(folder: Path, rig: Rig, seed: int, look: Look) -> list[str]:
    """Images of all cameras; the words for the command line."""
    random = np.random.default_rng([seed, 9])
    for c, camera in enumerate(rig):
        (folder / camera.name).mkdir()
        rows = ["file,t_s"]
        for i in range(round(SECONDS * RATE_HZ)):
            image = render(camera, i / RATE_HZ, _motion(seed), look).astype(np.float64)
            image = cv2.GaussianBlur(image, (0, 0), look.focus_px if c in look.blurred else 0.6)
            image = np.clip(image + random.normal(0, 1.5, image.shape), 0, 255).astype(np.uint8)
            cv2.imwrite(str(folder / camera.name / f"{i:03d}.jpg"), image[:, ::-1] if c in look.mirrored else image)
            rows.append(f"{i:03d}.jpg,{i / RATE_HZ:.6f}")
        (folder / camera.name / "timestamps.csv").write_text("\n".join(rows) + "\n")
    return [f"{camera.name}={folder / camera.name}" for camera in rig]


def calibrate_films(seed: int, look: Look, ids: tuple[int, ...] = (), settings: str = "") -> Answer:
    """Render, run `posefuse calibrate extrinsics`, and compare."""
    truth = room(seed)
    with tempfile.TemporaryDirectory() as name:
        folder, terminal = Path(name), _Recorded()
        inputs = _film(folder, truth, seed, look)
        write_rig(folder / "lenses.toml", truth)
        if settings:
            (folder / "posefuse.toml").write_text(settings)
        common = (
            "--intrinsics",
            str(folder / "lenses.toml"),
            "--target",
            str(write_target(folder / "cube.toml", Markers(SIDE_M, ids=ids))),
            "--out",
            str(folder / "rig.toml"),
        )
        try:
            invocation = parse(["calibrate", "extrinsics", *inputs, *common])
            assert invocation is not None
            with warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always", UserWarning)
                invocation.run(terminal)
        except CalibrationError as error:
            return Answer(True, str(error))
        terminal.words += [str(one.message) for one in warned if issubclass(one.category, UserWarning)]
        millimetres, degrees = errors(truth, read_rig(folder / "rig.toml"))
        if settings and "offset_s = 0.1" in (folder / "posefuse.toml").read_text():
            millimetres = _WRONG
    return Answer(False, "; ".join(terminal.words), millimetres, degrees)


def _case(name: str, cause: str, look: Look, ids: tuple[int, ...] = (), settings: str = "", group: str = "images") -> Case:
    return Case(name, group, cause, lambda seed: calibrate_films(seed, look, ids, settings))


STALE = "[cameras.cam01]\noffset_s = 0.1\n"
CASES = (
    _case("images of one camera mirrored", r"cam01.*mirrored", Look(mirrored=(1,))),
    _case("images of all cameras mirrored", r"mirrored", Look(mirrored=(0, 1, 2))),
    _case("wrong dictionary stated", r"DICT_5X5_100", Look(dictionary="DICT_5X5_100")),
    _case("print with colours exchanged", r"colours", Look(inverted=True)),
    _case("ids that are not on the prop", r"the target has ids 20, 21, 22", Look(), (20, 21, 22)),
    _case("one camera out of focus", r"cam01.{0,80}blur", Look(blurred=(1,))),
    _case("all images blurred by motion", r"blur", Look(exposure_s=0.35)),
    _case("old posefuse.toml next to a synchronised rig", r"posefuse\.toml", Look(), settings=STALE),
)  # fmt: skip
GOOD_SESSIONS = (
    _case("rendered, sharp", "", Look(), group=GOOD),
    _case("rendered, exposure of 20 ms", "", Look(exposure_s=0.02), group=GOOD),
)
