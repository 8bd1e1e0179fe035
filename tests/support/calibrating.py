"""What several tests of the calibration do: run its commands, compare rigs, put recordings of a target together."""

from dataclasses import replace
from typing import Any

import numpy as np

from posefuse.calibration.extrinsics.self_checks import camera_differences
from posefuse.calibration.solving.rotations import poses_of
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.cli.command_line import parse
from posefuse.cli.terminal import Terminal
from posefuse.core import Rig


def run(*words: str) -> dict[str, Any]:
    """The figures of a `posefuse calibrate` command."""
    found = parse(["calibrate", *words])
    assert found is not None
    return dict(found.run(Terminal(as_json=True)))


def differences(a: Rig, b: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Distance (C,) in m and angle (C,) in rad of each camera, up to where the world is."""
    return camera_differences(poses_of(a), poses_of(b))


def merged(a: CornerObservations, b: CornerObservations) -> CornerObservations:
    """Corners of the same cameras as one recording."""
    names = ("camera", "t_ns", "patch", "corner", "xy_img", "sharpness")
    return replace(a, **{name: np.concatenate([getattr(a, name), getattr(b, name)]) for name in names})
