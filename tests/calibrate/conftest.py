"""A small laboratory: four cameras with real lenses around a waved cube of markers."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from posefuse.calibrate.checks import camera_differences
from posefuse.calibrate.observations import Observations
from posefuse.calibrate.rotations import Poses, stacked
from posefuse.calibrate.synthetic import Faults, Waving, cube, observe_prop
from posefuse.calibrate.targets import Markers
from posefuse.core import Rig

LENS = (-0.12, 0.05, 0.001, -0.0005, 0.0)


@dataclass(frozen=True)
class Lab:
    rig: Rig
    target: Markers
    motion: Waving

    def watch(self, faults: Faults | None = None, motion: Waving | None = None, rig: Rig | None = None) -> Observations:
        return observe_prop(rig or self.rig, cube(0.3), self.target, motion or self.motion, faults or Faults())

    def errors(self, found: Rig) -> tuple[np.ndarray, np.ndarray]:
        """Distance in mm and angle in degrees of each camera from the truth, up to where the world is."""
        true = stacked([Poses.from_se3(self.rig[name].cam_from_world) for name in found.names])
        metres, radians = camera_differences(true, stacked([Poses.from_se3(c.cam_from_world) for c in found]))
        return metres * 1e3, np.rad2deg(radians)


@pytest.fixture(scope="session")
def lab(ring_rig: Callable[..., Rig]) -> Lab:
    return Lab(ring_rig(4, distortion=LENS), Markers(0.24), Waving(seconds=24.0, rate_hz=15.0))
