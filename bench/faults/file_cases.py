"""Faults of rig files, as `posefuse track` and `posefuse calibrate` would read them."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from posefuse.core import SE3, CalibrationError, Camera, Rig
from posefuse.formats.rig import write_rig
from posefuse.pipeline.config import TrackConfig
from posefuse.pipeline.session import find_session

from .sessions import one_changed, ring
from .verdict import Answer, Case

_WRONG = 1e6


def read_as_session(rig: Rig, edit: Callable[[str], str]) -> Answer:
    """Write the rig, edit the text of the file, and let a session be understood."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        write_rig(path, rig)
        path.write_text(edit(path.read_text()))
        (Path(folder) / "videos").mkdir()
        for camera in rig:
            (Path(folder) / "videos" / f"{camera.name}.mp4").touch()
        try:
            session = find_session(Path(folder), TrackConfig())
        except CalibrationError as error:
            return Answer(True, str(error))
        except ValueError as error:
            return Answer(True, str(error))
    return Answer(False, "; ".join(session.notes), _WRONG)


def _rig(seed: int) -> Rig:
    return ring(4 + seed % 5, seed, size_wh=(1280, 720))


def _cameras(name: str, cause: str, change: Callable[[tuple[Camera, ...]], tuple[Camera, ...]], why: str = "") -> Case:
    # our writer states which images are cut out of a sensor; files of others do not
    def faulty(seed: int) -> Answer:
        return read_as_session(Rig(change(_rig(seed).cameras)), lambda text: text.replace("cropped = true\n", ""))

    return Case(name, "rig file", cause, faulty, why)


def _text(name: str, cause: str, edit: Callable[[str], str]) -> Case:
    return Case(name, "rig file", cause, lambda s: read_as_session(_rig(s), edit))


def _one(change: Callable[[Camera], Camera]) -> Callable[[tuple[Camera, ...]], tuple[Camera, ...]]:
    return lambda cameras: one_changed(cameras, 1, change(cameras[1]))


def _matrix(change: np.ndarray) -> Callable[[Camera], Camera]:
    return lambda camera: replace(camera, K=camera.K * change)


def _every(key: str, change: Callable[[list[float]], list[float]]) -> Callable[[str], str]:
    """Change the list of numbers under a key of every camera."""

    def of_line(match: re.Match[str]) -> str:
        values = [float(value) for value in match.group(1).split(",")]
        return f"{key} = [{', '.join(map(str, change(values)))}]"

    return lambda text: re.sub(rf"^{key} = \[([^\[\]]*)\]", of_line, text, flags=re.MULTILINE)


CASES = (
    _cameras("fx twice as large as fy", r"cam01.*fx.*fy", _one(_matrix(np.diag([2.0, 1, 1]) + 1 - np.eye(3)))),
    _cameras("focal length a hundredth (mm for px)", r"cam01.*focal length",
             _one(_matrix(np.array([[0.01, 1, 1], [1, 0.01, 1], [1, 1, 1]])))),
    _cameras("all cameras at one place (intrinsics only)", r"intrinsics only|at one place|same place",
             lambda cs: tuple(replace(c, cam_from_world=SE3.identity()) for c in cs)),
    _cameras("two cameras at one place", r"cam01 and cam02.*(place|pose)",
             lambda cs: one_changed(cs, 2, replace(cs[2], cam_from_world=cs[1].cam_from_world))),
    _cameras("world_from_camera for cam_from_world", r"world_from_cam|inverse|inverted",
             lambda cs: tuple(replace(c, cam_from_world=c.cam_from_world.inverse()) for c in cs)),
    _cameras("principal point outside of the image", r"cam01.*principal point",
             _one(lambda c: replace(c, K=c.K + np.array([[0, 0, 900.0], [0, 0, 0], [0, 0, 0]])))),
    _cameras("absurd distortion", r"cam01.*distortion", _one(lambda c: replace(c, distortion=np.array([-4.0, 2.0, 0, 0, 0])))),
    _cameras("width and height swapped", r"cam01.*(width and height|size)", _one(lambda c: replace(c, size_wh=(720, 1280)))),
    _cameras("one camera alone", r"2 (calibrated )?cameras", lambda cs: cs[:1]),
    _text("rotation in degrees", r"rotation.*deg", _every("rotation", lambda v: [float(np.rad2deg(x)) for x in v])),
    _text("translation in millimetres", r"millimetres", _every("translation", lambda v: [1e3 * x for x in v])),
    _text("translation in centimetres", r"centimetres|metres", _every("translation", lambda v: [1e2 * x for x in v])),
    _text("NaN in a translation", r"finite|NaN", lambda text: text.replace("translation = [", "translation = [nan, ", 1)),
    _text("size in the order height, width for all", r"width and height|size",
          _every("size", lambda v: [int(x) for x in v[::-1]])),
)  # fmt: skip
