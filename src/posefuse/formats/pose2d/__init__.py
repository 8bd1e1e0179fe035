"""2D poses that other tools have written: one module per format, and one that recognises the format."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

from posefuse.core import SKELETONS, InputError, Skeleton
from posefuse.core.errors import choices
from posefuse.foundation.parsing import short

from . import coco, deeplabcut, mmpose, openpose
from .frames import UNTRACKED, People2D, Pose2DFrames, parsed_json
from .openpose import read_openpose_folder

# what reading values of the wrong type or shape may raise, tables that break off included
_MALFORMED = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError, OSError, RuntimeError, csv.Error)
POSE2D_SUFFIXES = (".json", ".csv", ".h5")
PREDICTIONS_FOLDER = "predictions"
"""Where MMPose puts its files in the folder that it is given for them."""


FORMATS: tuple[ModuleType, ...] = (openpose, mmpose, coco, deeplabcut)
"""One module per format: its NAME, what it LOOKS_FOR to recognise it, `fits` and `read`."""


def read_pose2d(path: Path, camera: str, *, skeleton: Skeleton | None = None) -> Pose2DFrames:
    """One camera's 2D poses, of whatever format they are.

    Args:
        path: a file, a folder with one file per frame, or one that has either in a folder `PREDICTIONS_FOLDER`.
        camera: name in the rig.
        skeleton: keypoint set; None: recognised from the files.

    Raises:
        InputError: nothing there, no format that fits (lists what was looked for), or content that is not as it should be.
    """
    if not path.exists():
        raise InputError(f"{path}: camera {camera}: no such file or folder of 2D poses")
    if (path / PREDICTIONS_FOLDER).is_dir():
        path /= PREDICTIONS_FOLDER
        [path] = files if len(files := [*path.glob("*.json")]) == 1 else [path]
    for format in FORMATS:
        if _fits(format, path):
            try:
                found: Pose2DFrames = format.read(path, camera, skeleton)
                return found
            except _MALFORMED as error:
                raise InputError(f"{path}: camera {camera}: damaged {format.NAME} data ({short(error)})") from None
            finally:
                parsed_json.cache_clear()
    looked = "; ".join(f"{format.NAME}: {format.LOOKS_FOR}" for format in FORMATS)
    raise InputError(f"{path}: camera {camera}: no format of 2D poses recognised; looked for {looked}")


def read_pose2d_of_cameras(paths: Mapping[str, Path], keypoints: str = "") -> list[Pose2DFrames]:
    """2D poses of several cameras, all in one order of keypoints: what one camera leaves open, the people of all decide.

    Args:
        paths: as for `read_pose2d`, by camera name. keypoints: name of the keypoint set; empty to recognise it.

    Raises:
        InputError: as `read_pose2d`; or no such keypoint set.
    """
    if keypoints and keypoints not in SKELETONS:
        raise InputError(f"keypoints: no set {keypoints!r}; there are: {choices(SKELETONS)}")
    stated = SKELETONS.get(keypoints)
    order = stated or openpose.body_order(path for path in paths.values() if openpose.fits(path))
    return [read_pose2d(path, name, skeleton=order if openpose.fits(path) else stated) for name, path in paths.items()]


def _fits(format: ModuleType, path: Path) -> bool:
    try:
        return bool(format.fits(path))
    except _MALFORMED:
        return False
