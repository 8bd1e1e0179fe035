"""`posefuse calibrate person`."""

from __future__ import annotations

from posefuse.cli.options.calibration import (
    CameraRecordings,
    PersonOptions,
    RigOptions,
)
from posefuse.cli.options.shared import Figures, NetworkOptions, Shown


def calibrate_person(
    *inputs: CameraRecordings,
    options: PersonOptions,
    files: RigOptions,
    networks: NetworkOptions = NetworkOptions(),
    terminal: Shown,
) -> Figures:
    """Find the pose of each camera (extrinsics) from a person who walks in front of the cameras.

    Args:
        inputs: Video, or 2D poses of another tool, per camera; NAME defaults to the file's name.
    """
    from posefuse.cli.calibrating.person_steps import person

    return person(inputs, options, files, networks, terminal)
