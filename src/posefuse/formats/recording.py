"""The lossless result folder: arrays, rig and provenance, each in a file of its own.

``recording.npz`` holds the 3D result, ``observations.npz`` every detection that it was made from, ``recording.json`` the format
version, skeleton and cameras and how the result was made, ``rig.toml`` the cameras for other programs. Written inside a folder
that exists: put `output_folder.output_folder` around a whole result.

A result with depth has a format version of its own, so that an older posefuse refuses it; one without is as it always was.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.core import SE3, Camera, InputError, Observations, PosefuseError, PoseSequence, Recording, Rig, Skeleton
from posefuse.core.observations import OBSERVATION_ARRAYS, observations_from_frames
from posefuse.foundation.output_file import write_text
from posefuse.foundation.parsing import one_line, parse_json, read_text

from .npz import DAMAGED, read_arrays, write_arrays
from .rig import read_rig, write_rig

# A rig as plain JSON values to the last bit, which files for other programs do not keep.


def rig_values(rig: Rig) -> dict[str, Any]:
    """Plain values; `rig_from_values` gives the same rig back."""
    cameras = [camera_values(camera) for camera in rig]
    residual_px = None if math.isnan(rig.residual_px) else rig.residual_px
    return {"cameras": cameras, "world_set_by": rig.world_set_by, "residual_px": residual_px, "refused": rig.refused}


def rig_from_values(content: Mapping[str, Any]) -> Rig:
    """The rig of `rig_values`; raises KeyError, TypeError, ValueError or PosefuseError for anything else."""
    cameras = tuple(map(camera_from_values, content["cameras"]))
    residual_px = math.nan if content["residual_px"] is None else content["residual_px"]
    return Rig(cameras, content["world_set_by"], residual_px, content.get("refused", ""))


def camera_values(camera: Camera) -> dict[str, Any]:
    """Plain values of one camera."""
    return {
        "name": camera.name,
        "size_wh": list(camera.size_wh),
        "K": camera.K.tolist(),
        "wxyz": camera.cam_from_world.wxyz.tolist(),
        "xyz": camera.cam_from_world.xyz.tolist(),
        "distortion": camera.distortion.tolist(),
        "model": camera.model,
        "readout_s": camera.readout_s,
    }


def camera_from_values(content: Mapping[str, Any]) -> Camera:
    """The camera of `camera_values`; raises as `rig_from_values` does."""
    same = {name: content[name] for name in ("name", "size_wh", "K", "distortion", "model", "readout_s")}
    return Camera(cam_from_world=SE3(content["wxyz"], content["xyz"]), **same)


ARRAYS_FILE = "recording.npz"
OBSERVATIONS_FILE = "observations.npz"
ABOUT_FILE = "recording.json"
RIG_FILE = "rig.toml"
RECORDING_FILES = (ARRAYS_FILE, OBSERVATIONS_FILE, RIG_FILE, ABOUT_FILE)
FORMAT_VERSION = 3
DEPTH_VERSION = 4
_POSES = tuple(field.name for field in dataclasses.fields(PoseSequence) if field.name != "skeleton")


def write_recording(folder: Path, recording: Recording) -> list[Path]:
    """Write a recording into an existing folder; `read_recording` gives every bit of it back.

    Returns:
        The files made.

    Raises:
        InputError: the folder cannot be written to, or the provenance holds something other than plain JSON values.
    """
    arrays = {name: getattr(recording.poses, name) for name in _POSES}
    observed = {name: getattr(recording.observations, name) for name in OBSERVATION_ARRAYS}
    with_depth = recording.observations.depth_m is not None
    if with_depth:
        observed["depth_m"] = recording.observations.depth_m
    about = {
        "format": "posefuse recording",
        "format_version": DEPTH_VERSION if with_depth else FORMAT_VERSION,
        "rig_id": recording.rig.id,
        "rig": rig_values(recording.rig),
        "skeleton": dataclasses.asdict(recording.poses.skeleton),
        "provenance": dict(recording.provenance),
    }
    try:
        text = json.dumps(about, indent=2, ensure_ascii=False)
    except (TypeError, ValueError) as error:
        raise InputError(f"{folder / ABOUT_FILE}: provenance: expected plain JSON values ({error})") from None
    write_arrays(folder / ARRAYS_FILE, arrays)
    write_arrays(folder / OBSERVATIONS_FILE, observed)
    write_rig(folder / RIG_FILE, recording.rig)
    write_text(folder / ABOUT_FILE, text + "\n")
    return [folder / name for name in RECORDING_FILES]


def read_recording(folder: Path | str, *, observed: bool = True) -> Recording:
    """Read a result folder; with `observed` off without the detections that it was made from, in a fraction of the time.

    Raises:
        InputError: not a result folder, one of a newer format, or files that do not belong together.
    """
    folder = Path(folder)
    about = _about(folder)
    arrays = read_arrays(folder / ARRAYS_FILE)
    found = read_rig(folder / RIG_FILE).id
    if found != about["rig_id"]:
        raise InputError(f"{folder}: {RIG_FILE} is rig {found}, the result was made with rig {about['rig_id']}")
    try:
        rig = rig_from_values(about["rig"])
        skeleton = Skeleton(**{key: about["skeleton"][key] for key in ("name", "keypoints", "bones")})
        poses = PoseSequence(skeleton=skeleton, **{name: arrays[name] for name in _POSES})
        if observed:
            parts = read_arrays(folder / OBSERVATIONS_FILE)
            names = OBSERVATION_ARRAYS + (("depth_m",) if about["format_version"] == DEPTH_VERSION else ())
            seen = Observations(skeleton=skeleton, camera_names=rig.names, **{name: parts[name] for name in names})
        else:
            seen = dataclasses.replace(observations_from_frames(skeleton, rig.names, ()), step_t_ns=poses.t_ns)
        return Recording(rig=rig, poses=poses, observations=seen, provenance=about["provenance"])
    except KeyError as error:
        raise InputError(f"{folder}: the result is incomplete: {one_line(error)} is missing") from None
    except (PosefuseError, *DAMAGED, IndexError) as error:
        raise InputError(f"{folder}: the result does not fit together: {one_line(error)}") from None


def _about(folder: Path) -> dict[str, Any]:
    path = folder / ABOUT_FILE
    if not path.is_file():
        raise InputError(f"{folder}: not a posefuse result: there is no {ABOUT_FILE}")
    about = parse_json(str(path), read_text(path))
    if not isinstance(about, dict) or about.get("format") != "posefuse recording":
        raise InputError(f"{path}: not a posefuse result")
    version = about.get("format_version")
    if version not in (FORMAT_VERSION, DEPTH_VERSION):
        older = isinstance(version, int) and version < FORMAT_VERSION
        whose = "an older posefuse wrote it: track the session again" if older else "a newer posefuse wrote it"
        raise InputError(f"{path}: format version: expected {FORMAT_VERSION} or {DEPTH_VERSION}, got {version}; {whose}")
    missing = [key for key in ("rig_id", "rig", "skeleton", "provenance") if key not in about]
    if missing:
        raise InputError(f"{path}: {missing[0]} is missing")
    return about
