"""The truth of a simulated session as one .npz file of plain arrays.

Arrays: ``t_ns person_id xyz_world`` and, per camera number i, ``view<i>_t_ns view<i>_xy_img view<i>_visible``; joints as
``joints_*``; the cameras and all names as JSON in ``description``. Same values, same bytes.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import SE3, SKELETONS, CameraTruth, InputError, JointAngles, PosefuseError, Rig, Truth
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import one_line, parse_json, read_bytes, short

from .npz import DAMAGED, read_arrays, write_arrays
from .recording import camera_from_values, camera_values

LOOP_FILE = "loop.json"
_FORMAT = "posefuse truth 1"


def write_truth(path: Path, truth: Truth) -> None:
    """Write a truth; raises InputError when the file cannot be written."""
    arrays: dict[str, Array] = {"t_ns": truth.t_ns, "person_id": truth.person_id, "xyz_world": truth.xyz_world}
    for i, view in enumerate(truth.views):
        arrays |= {f"view{i}_t_ns": view.t_ns, f"view{i}_xy_img": view.xy_img, f"view{i}_visible": view.visible}
    description: dict[str, Any] = {
        "format": _FORMAT,
        "skeleton": truth.skeleton.name,
        "world_set_by": truth.rig.world_set_by,
        "cameras": [camera_values(camera) for camera in truth.rig],
    }
    if truth.joints is not None:
        joints = truth.joints
        pose = joints.world_from_segment
        arrays |= {"joints_t_ns": joints.t_ns, "joints_wxyz": pose.wxyz, "joints_xyz": pose.xyz}
        arrays |= {"joints_angle_rad": joints.angle_rad, "joints_sigma_rad": joints.sigma_rad}
        description["joints"] = {"segments": joints.segments, "joints": joints.joints, "angle_names": joints.angle_names}
    arrays["description"] = np.frombuffer(json.dumps(description).encode(), np.uint8)
    write_arrays(path, arrays)


def read_truth(path: Path) -> Truth:
    """Read what `write_truth` wrote; raises InputError when it is not such a file."""
    arrays = read_arrays(path)
    try:
        description = parse_json(f"{path}: description", arrays["description"].tobytes())
        if description["format"] != _FORMAT:
            raise InputError(f"{path}: expected a file of format {_FORMAT!r}, got {short(description['format'])}")
        rig = Rig(tuple(map(camera_from_values, description["cameras"])), description["world_set_by"], 0.0)
        views = tuple(
            CameraTruth(camera=name, **{field: arrays[f"view{i}_{field}"] for field in ("t_ns", "xy_img", "visible")})
            for i, name in enumerate(rig.names)
        )
        joints = _joints(arrays, description["joints"]) if "joints" in description else None
        everyone = {field: arrays[field] for field in ("t_ns", "person_id", "xyz_world")}
        return Truth(rig=rig, skeleton=SKELETONS[description["skeleton"]], views=views, joints=joints, **everyone)
    except PosefuseError as error:
        raise InputError(f"{path}: not a posefuse truth file ({one_line(error)})") from None
    except (*DAMAGED, IndexError, AttributeError) as error:
        raise InputError(f"{path}: not a posefuse truth file ({type(error).__name__}: {one_line(error)})") from None


def write_loop(folder: Path, loop_ns: int) -> None:
    """Write next to a truth that its motion repeats every `loop_ns`, for simulators that run endlessly."""
    (folder / LOOP_FILE).write_text(json.dumps({"loop_ns": loop_ns}) + "\n", encoding="utf-8")


def read_loop(folder: Path) -> int | None:
    """What `write_loop` wrote, None where it wrote nothing; raises InputError when the file is not of that kind."""
    path = folder / LOOP_FILE
    if not path.is_file():
        return None
    loop = parse_json(str(path), read_bytes(path))
    if not isinstance(loop, dict) or not isinstance(loop.get("loop_ns"), int) or loop["loop_ns"] <= 0:
        raise InputError(f'{path}: expected {{"loop_ns": nanoseconds > 0}}, got {one_line(loop)}')
    return int(loop["loop_ns"])


def _joints(arrays: dict[str, Array], names: dict[str, Any]) -> JointAngles:
    return JointAngles(
        person_id=arrays["person_id"],
        segments=tuple(names["segments"]),
        world_from_segment=SE3(arrays["joints_wxyz"], arrays["joints_xyz"]),
        joints=tuple(names["joints"]),
        angle_names=tuple(tuple(three) for three in names["angle_names"]),
        **{field: arrays[f"joints_{field}"] for field in ("t_ns", "angle_rad", "sigma_rad")},
    )
