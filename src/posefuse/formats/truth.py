"""The truth of a simulated session as one .npz file of plain arrays.

Arrays: ``t_ns person_id xyz_world`` and, per camera number i, ``view<i>_t_ns view<i>_xy_img view<i>_visible``; joints as
``joints_*``; the cameras and all names as JSON in ``description``. Same values, same bytes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from posefuse.core import SE3, SKELETONS, CameraTruth, InputError, JointAngles, PosefuseError, Rig, Truth
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import one_line, parse_json, read_bytes, short

from .npz import DAMAGED, read_arrays
from .recording import camera_from_values

LOOP_FILE = "loop.json"
FORMAT = "posefuse truth 1"


def read_truth(path: Path) -> Truth:
    """Read what `posefuse_sim.files.write_truth` wrote; raises InputError when it is not such a file."""
    arrays = read_arrays(path)
    try:
        description = parse_json(f"{path}: description", arrays["description"].tobytes())
        if description["format"] != FORMAT:
            raise InputError(f"{path}: expected a file of format {FORMAT!r}, got {short(description['format'])}")
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


def read_loop(folder: Path) -> int | None:
    """After how long the motion of a truth repeats; None where it does not. Raises InputError for another file."""
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
