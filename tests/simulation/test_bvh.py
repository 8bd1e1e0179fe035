"""Reading BVH files."""

from pathlib import Path

import numpy as np
import pytest
from checks import refusal
from scipy.spatial.transform import Rotation

from posefuse.core import InputError
from posefuse_sim.motion.bvh import read_bvh

ARM = """HIERARCHY
ROOT Base
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Upper
  {
    OFFSET 0 2 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 3 0 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
1 2 3 0 0 0 0 0 0
1 2 3 90 0 0 0 90 0
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "arm.bvh"
    path.write_text(text)
    return path


def test_positions_by_hand(tmp_path: Path) -> None:
    data = read_bvh(written(tmp_path, ARM))
    assert data.names == ("Base", "Upper", "Upper_end")
    assert data.frame_s == 0.04
    assert np.allclose(data.rest_positions(), [[0, 0, 0], [0, 2, 0], [3, 2, 0]])
    _, position = data.world()
    assert np.allclose(position[0], [[1, 2, 3], [1, 4, 3], [4, 4, 3]])
    # a quarter turn about z moves (0, 2, 0) to (-2, 0, 0); then (3, 0, 0) turned about y points along -z, which z leaves alone
    assert np.allclose(position[1], [[1, 2, 3], [-1, 2, 3], [-1, 2, 0]])


@pytest.mark.parametrize("order", ["Zrotation Xrotation Yrotation", "Xrotation Yrotation Zrotation"])
def test_channels_apply_in_the_file_s_order(tmp_path: Path, order: str) -> None:
    text = ARM.replace("Zrotation Yrotation Xrotation", order).replace("1 2 3 0 0 0 0 0 0", "1 2 3 0 0 0 20 30 40")
    rotation, _ = read_bvh(written(tmp_path, text)).world()
    axes = "".join(name[0] for name in order.split())
    assert np.allclose(rotation[0, 1], Rotation.from_euler(axes, (20, 30, 40), degrees=True).as_matrix())


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("HIERARCHY", "HIRARCHY", "line 1: expected 'HIERARCHY', got 'HIRARCHY'"),
        ("OFFSET 0 2 0", "OFFSET 0 two 0", "line 8: expected 3 numbers after OFFSET of Upper, got 'two'"),
        ("Yrotation Xrotation\n    End", "Yrotation W\n    End", "line 9: expected a channel of Upper out of .*, got 'W'"),
        ("JOINT Upper", "JOINT Base", "joint 'Base' appears twice"),
        ("}\nMOTION", "MOTION", "expected CHANNELS, JOINT, End or '}' of joint Base, got 'MOTION'"),
        ("Frames: 2", "Frames: 3", "MOTION: expected 3 frames of 9 numbers = 27, got 18 numbers"),
        ("Frame Time: 0.04", "Frame Time: 0", "frame time > 0 s, got 2 frames of 0.0 s"),
        ("1 2 3 90", "1 2 x 90", "MOTION: expected numbers only"),
        ("1 2 3 90", "1 2 nan 90", "MOTION: expected finite numbers, .* in frame 1"),
        ("MOTION", "", "expected 'MOTION'"),
    ],
)  # fmt: skip
def test_broken_files_are_named_with_their_line(tmp_path: Path, old: str, new: str, text: str) -> None:
    assert old in ARM
    path = written(tmp_path, ARM.replace(old, new))
    refusal(InputError, f"{path.name}: .*{text}", read_bvh, path)


def test_cut_off_file(tmp_path: Path) -> None:
    refusal(InputError, "got the end of the file", lambda: read_bvh(written(tmp_path, ARM[:120])))
    refusal(InputError, "cannot be read", read_bvh, tmp_path / "none.bvh")
