"""A rig as plain JSON values to the last bit, which files for other programs do not keep."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from posefuse.core import SE3, Camera, Rig


def rig_values(rig: Rig) -> dict[str, Any]:
    """Plain values; `rig_from_values` gives the same rig back."""
    cameras = [
        {
            "name": camera.name,
            "size_wh": list(camera.size_wh),
            "K": camera.K.tolist(),
            "wxyz": camera.cam_from_world.wxyz.tolist(),
            "xyz": camera.cam_from_world.xyz.tolist(),
            "distortion": camera.distortion.tolist(),
            "model": camera.model,
            "readout_s": camera.readout_s,
        }
        for camera in rig
    ]
    residual_px = None if math.isnan(rig.residual_px) else rig.residual_px
    return {"cameras": cameras, "world_set_by": rig.world_set_by, "residual_px": residual_px, "refused": rig.refused}


def rig_from_values(content: Mapping[str, Any]) -> Rig:
    """The rig of `rig_values`; raises KeyError, TypeError, ValueError or PosefuseError for anything else."""
    cameras = tuple(
        Camera(
            name=one["name"],
            size_wh=tuple(one["size_wh"]),
            K=one["K"],
            cam_from_world=SE3(one["wxyz"], one["xyz"]),
            distortion=one["distortion"],
            model=one["model"],
            readout_s=one["readout_s"],
        )
        for one in content["cameras"]
    )
    residual_px = math.nan if content["residual_px"] is None else content["residual_px"]
    return Rig(cameras, content["world_set_by"], residual_px, content.get("refused", ""))
