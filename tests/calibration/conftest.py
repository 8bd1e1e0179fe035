"""A small laboratory (four cameras with real lenses around a waved cube of markers), and a real board before webcams."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from calibrating import differences

from bench.faults.waved_props import Faults, Waving, cube, observe_prop
from posefuse.calibration.targets.corners import CornerObservations, joined
from posefuse.calibration.targets.detection import detect_corners
from posefuse.calibration.targets.kinds import Charuco, Markers
from posefuse.core import Rig
from posefuse.formats.rig import read_rig
from posefuse.sources import VideoConfig

LENS = (-0.12, 0.05, 0.001, -0.0005, 0.0)


@dataclass(frozen=True)
class Lab:
    rig: Rig
    target: Markers
    motion: Waving

    def watch(self, faults: Faults | None = None, motion: Waving | None = None, rig: Rig | None = None) -> CornerObservations:
        return observe_prop(rig or self.rig, cube(0.3), self.target, motion or self.motion, faults or Faults())

    def errors(self, found: Rig, scaled: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Distance in mm and angle in degrees of each camera from the truth, as `differences`."""
        metres, radians = differences(Rig(tuple(self.rig[name] for name in found.names)), found, scaled)
        return metres * 1e3, np.rad2deg(radians)


@pytest.fixture(scope="session")
def lab(ring_rig: Callable[..., Rig]) -> Lab:
    return Lab(ring_rig(4, distortion=LENS), Markers(0.24), Waving(seconds=24.0, rate_hz=15.0))


@pytest.fixture(scope="session")
def board() -> Charuco:
    """The board of `caliscope/post_optimization`."""
    return Charuco(columns=4, rows=5, square_m=0.054, marker_m=0.0405, dictionary="DICT_4X4_1000", inverted=True)


@pytest.fixture(scope="session")
def reference(shared_data: Path) -> Rig:
    """The lenses and places that came with that recording."""
    return read_rig(shared_data / "caliscope" / "post_optimization" / "camera_array.toml")


@pytest.fixture(scope="session")
def board_views(shared_data: Path, board: Charuco) -> CornerObservations:
    """That board in the images of its four webcams."""
    folder = shared_data / "caliscope" / "post_optimization" / "calibration" / "extrinsic"
    return joined([detect_corners(VideoConfig(folder / f"cam_{i}.mp4", f"cam_{i}").build(), board) for i in range(4)])
