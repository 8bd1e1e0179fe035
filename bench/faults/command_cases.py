"""Faults that only images and files show: rendered markers through the command line."""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posefuse.calibration.targets.kinds import Markers, write_target
from posefuse.cli.command_line import parse
from posefuse.cli.terminal import Terminal
from posefuse.core import CalibrationError
from posefuse.formats.rig import read_rig
from posefuse.foundation.settings import settings_from_mapping
from posefuse_sim import Scene, SessionPaths, simulate

from .sessions import errors
from .verdict import GOOD, Answer, Case

_WRONG = 1e6
SIDE_M, EDGE_M, RATE_HZ, SECONDS = 0.28, 0.36, 8.0, 7.0


@dataclass(frozen=True)
class Look:
    """How the images are made.

    Attributes:
        exposure_s: the prop moves on meanwhile. mirrored: cameras whose images are flipped. inverted: colours.
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


def scene_of(seed: int, look: Look) -> Scene:
    """A cube of markers waved before three cameras near each other."""
    random, cameras = np.random.default_rng([seed, 7]), []
    for i in range(3):
        angle = 2 * np.pi * i / 8 + random.uniform(-0.15, 0.15)
        place: dict[str, Any] = {"position_m": [2.6 * np.cos(angle), 2.6 * np.sin(angle), random.uniform(1.9, 2.5)]}
        image = {"size_px": [640, 480], "horizontal_fov_deg": random.uniform(57, 60)}
        sensor = {"noise_dn": 1.5, "exposure_s": look.exposure_s}
        cameras.append({"name": f"cam{i:02d}", **place, "look_at_m": [0, 0, 1.0], "image": image, "sensor": sensor})
    path = {"kind": "waved", "extent_m": [1.2, 1.2, 0.8], "speed_mps": 0.4}
    cube = {"kind": "aruco_cube", "side_m": EDGE_M, "marker_m": SIDE_M, "dictionary": look.dictionary, "path": path}
    about = {"duration_s": SECONDS, "rate_hz": RATE_HZ, "seed": seed, "record": {"kind": "jpeg"}}
    return settings_from_mapping(
        {**about, "cameras": {"kind": "list", "cameras": cameras}, "props": [cube]}, Scene, where="faults"
    )


def spoiled(folder: Path, camera: int, look: Look) -> None:
    """Change the images of a camera in place."""
    for path in sorted(folder.glob("*.jpg")):
        image = cv2.imread(str(path))
        image = 255 - image if look.inverted else image
        image = cv2.GaussianBlur(image, (0, 0), look.focus_px) if camera in look.blurred else image
        cv2.imwrite(str(path), image[:, ::-1] if camera in look.mirrored else image)


def calibrate_images(seed: int, look: Look, ids: tuple[int, ...] = (), settings: str = "") -> Answer:
    """Render, run `posefuse calibrate extrinsics`, and compare."""
    with tempfile.TemporaryDirectory() as name:
        folder, terminal, session = Path(name), _Recorded(), SessionPaths(Path(name) / "session")
        simulate(scene_of(seed, look), session.folder, processes=1)
        truth = read_rig(session.rig)
        inputs = [session.videos / camera for camera in truth.names]
        for i, images in enumerate(inputs):
            spoiled(images, i, look)
        if settings:
            (folder / "posefuse.toml").write_text(settings)
        target = write_target(folder / "cube.toml", Markers(SIDE_M, ids=ids))
        common = ("--intrinsics", str(session.rig), "--target", str(target), "--out", str(folder / "rig.toml"))
        try:
            invocation = parse(["calibrate", "extrinsics", *(f"{images.name}={images}" for images in inputs), *common])
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
    return Case(name, group, cause, lambda seed: calibrate_images(seed, look, ids, settings))


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
