"""Makes the golden files in forms that posefuse writes; the rigs in other tools' forms are kept as they are."""

import json
from pathlib import Path

import numpy as np

from posefuse.core import SE3, Camera, Rig
from posefuse.formats.rig import write_rig
from posefuse.formats.trc import TrcData, write_trc

HERE = Path(__file__).parent


def golden_rig() -> Rig:
    K = np.array([[903.5, 0, 618.25], [0, 907.75, 394.5], [0, 0, 1]])
    poses = [SE3.from_rotvec([0.1 * i, -1.2, 0.4], [0.25 * i, -0.5, 3.0 + i]) for i in range(2)]
    lens = {"K": K, "distortion": np.array([-0.3, 0.05, 0.001, -0.002])}
    cameras = [Camera(name=f"cam_{i}", size_wh=(1280, 720), cam_from_world=pose, **lens) for i, pose in enumerate(poses)]
    return Rig(tuple(cameras), world_set_by="golden", residual_px=0.5)


def golden_trc() -> TrcData:
    xyz = np.arange(3 * 2 * 3).reshape(3, 2, 3) / 8
    xyz[1, 0] = np.nan
    return TrcData(names=("left_hip", "right_hip"), t_s=np.arange(3) / 50, xyz_world=xyz, rate_hz=50.0)


if __name__ == "__main__":
    rig = golden_rig()
    write_rig(HERE / "rig.toml", rig)
    write_trc(HERE / "pose.trc", golden_trc())
    (HERE / "facts.json").write_text(json.dumps({"rig_id": rig.id}) + "\n")
