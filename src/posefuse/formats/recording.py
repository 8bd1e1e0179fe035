"""The lossless result folder: arrays, rig and provenance, each in a file of its own.

``recording.npz`` holds the arrays, ``rig.toml`` the cameras, ``recording.json`` the format version, the skeleton and how the
result was made. Written inside a folder that exists: put `atomic.atomic_folder` around a whole result.
"""

from __future__ import annotations

import dataclasses
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import InputError, PosefuseError, PoseSequence, Recording, Skeleton
from posefuse.foundation.atomic import atomic_file

from .rig import read_rig, write_rig

ARRAYS_FILE = "recording.npz"
ABOUT_FILE = "recording.json"
RIG_FILE = "rig.toml"
FORMAT_VERSION = 1
_POSES = tuple(field.name for field in dataclasses.fields(PoseSequence) if field.name != "skeleton")
_VIEWS = ("xy_img", "score", "sigma_px")


def write_recording(folder: Path, recording: Recording) -> list[Path]:
    """Write a recording into an existing folder; `read_recording` gives every bit of it back.

    Returns:
        The files made.

    Raises:
        InputError: the folder cannot be written to, or the provenance holds something other than plain JSON values.
    """
    arrays = {name: getattr(recording.poses, name) for name in _POSES} | {f"views_{n}": getattr(recording, n) for n in _VIEWS}
    about = {
        "format": "posefuse recording",
        "format_version": FORMAT_VERSION,
        "rig_id": recording.rig.id,
        "skeleton": dataclasses.asdict(recording.poses.skeleton),
        "provenance": dict(recording.provenance),
    }
    try:
        text = json.dumps(about, indent=2, ensure_ascii=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"{folder / ABOUT_FILE}: provenance: expected plain JSON values ({error})") from None
    with atomic_file(folder / ARRAYS_FILE) as beside:
        np.savez_compressed(beside, **arrays)
    write_rig(folder / RIG_FILE, recording.rig)
    with atomic_file(folder / ABOUT_FILE) as beside:
        beside.write_text(text + "\n", encoding="utf-8")
    return [folder / ARRAYS_FILE, folder / RIG_FILE, folder / ABOUT_FILE]


def read_recording(folder: Path | str) -> Recording:
    """Read a result folder.

    Raises:
        InputError: not a result folder, one of a newer format, or files that do not belong together.
    """
    folder = Path(folder)
    about = _about(folder)
    arrays = _arrays(folder / ARRAYS_FILE)
    rig = read_rig(folder / RIG_FILE)
    if rig.id != about["rig_id"]:
        raise InputError(f"{folder}: {RIG_FILE} is rig {rig.id}, the result was made with rig {about['rig_id']}")
    try:
        poses = PoseSequence(skeleton=_skeleton(about["skeleton"]), **{name: arrays[name] for name in _POSES})
        views = {name: arrays[f"views_{name}"] for name in _VIEWS}
        return Recording(rig, poses, provenance=about["provenance"], **views)
    except (KeyError, TypeError) as error:
        raise InputError(f"{folder}: the result is incomplete: {error} is missing") from None
    except PosefuseError as error:
        raise InputError(f"{folder}: the result does not fit together: {error}") from None


def _about(folder: Path) -> dict[str, Any]:
    path = folder / ABOUT_FILE
    if not path.is_file():
        raise InputError(f"{folder}: not a posefuse result: there is no {ABOUT_FILE}")
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    if not isinstance(about, dict) or about.get("format") != "posefuse recording":
        raise InputError(f"{path}: not a posefuse result")
    if about.get("format_version") != FORMAT_VERSION:
        raise InputError(
            f"{path}: format version: expected {FORMAT_VERSION}, got {about.get('format_version')}; a newer posefuse wrote it"
        )
    missing = [key for key in ("rig_id", "skeleton", "provenance") if key not in about]
    if missing:
        raise InputError(f"{path}: {missing[0]} is missing")
    return about


def _arrays(path: Path) -> dict[str, Any]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None


def _skeleton(content: dict[str, Any]) -> Skeleton:
    return Skeleton(content["name"], tuple(content["keypoints"]), tuple((a, b) for a, b in content["bones"]))
