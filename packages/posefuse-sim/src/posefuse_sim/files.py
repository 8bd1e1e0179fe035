"""Files that posefuse reads and does not write: of simulated sessions, and fitted tables. Readers are in `posefuse.formats`."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.core import InputError, JointCentres, Truth
from posefuse.core.arrays import Array
from posefuse.core.depth import DepthImage
from posefuse.formats.image_folders import ABOUT_FILE, TIMES_FILE, depth_name
from posefuse.formats.npz import write_arrays
from posefuse.formats.recording import camera_values
from posefuse.formats.truth import FORMAT, LOOP_FILE


def write_truth(path: Path, truth: Truth) -> None:
    """Write a truth; raises InputError when the file cannot be written."""
    arrays: dict[str, Array] = {"t_ns": truth.t_ns, "person_id": truth.person_id, "xyz_world": truth.xyz_world}
    for i, view in enumerate(truth.views):
        arrays |= {f"view{i}_t_ns": view.t_ns, f"view{i}_xy_img": view.xy_img, f"view{i}_visible": view.visible}
    description: dict[str, Any] = {
        "format": FORMAT,
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


def write_loop(folder: Path, loop_ns: int) -> None:
    """Write next to a truth that its motion repeats every `loop_ns`, for simulators that run endlessly."""
    (folder / LOOP_FILE).write_text(json.dumps({"loop_ns": loop_ns}) + "\n", encoding="utf-8")


def write_frame_times(folder: Path, times: Iterable[tuple[str, int]]) -> None:
    """Write the names of images and their times in ns."""
    with (folder / TIMES_FILE).open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(["file", "t_s"])
        table.writerows([name, f"{t_ns / 1e9:.9f}"] for name, t_ns in times)


def write_depth(folder: Path, t_ns: int, depth: DepthImage) -> None:
    """Write one image into an existing folder, and what is known of the camera with the first; raises InputError."""
    import cv2

    path = folder / depth_name(t_ns)
    _, data = cv2.imencode(".png", depth.values, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    try:
        if not (folder / ABOUT_FILE).exists():
            about = {"unit_m": depth.unit_m, "noise": asdict(depth.noise)}
            (folder / ABOUT_FILE).write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


def joint_centres_text(table: JointCentres) -> str:
    """The table as TOML, as `read_joint_centres` reads it; to a tenth of a millimetre."""
    lines = [
        "# metres from the fused landmark to the joint centre along directions of the body itself, see tracking/joint_centres.py",
        f'made_by = "{table.made_by}"',
        *_section("lengths", table.lengths, 3),
    ]
    for joint, offsets in table.offsets.items():
        lines += _section(f"offsets.{joint}", offsets, 4)
    for joint, directions in table.by_length.items():
        for name, slopes in directions.items():
            lines += _section(f"by_length.{joint}.{name}", slopes, 3)
    return "\n".join(lines) + "\n"


def _section(name: str, values: Mapping[str, float], digits: int) -> list[str]:
    return ["", f"[{name}]", *(f"{key} = {value:.{digits}f}" for key, value in values.items())]
