"""`posefuse calibrate person`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

from .calibrate_options import (
    MOST_FRAMES,
    MOST_HEIGHT_M,
    CameraRecordings,
    Clocks,
    MostSeconds,
    RateHz,
    RigFile,
    RigOptions,
    UpsideDown,
)
from .options import Figures, NetworkOptions, Shown, count, positive


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class PersonOptions:
    """How the camera poses are found from a person."""

    intrinsics: RigFile
    """Rig file with the intrinsics."""
    height_m: Annotated[float | None, Parameter(metavar="M"), positive(MOST_HEIGHT_M)] = None
    """Height of the person in metres, which sets the scale within a few per cent."""
    apart: Annotated[tuple[str, str, float] | None, Parameter(metavar="CAMERA CAMERA METRES")] = None
    """Or: the measured distance of two cameras."""
    rate_hz: RateHz = None
    """Frame rate of 2D poses."""
    time_steps: Annotated[int, Parameter(alias="--instants", metavar="N"), count(MOST_FRAMES)] = 600
    """Largest number of time steps of the videos to use."""
    clocks: Clocks = "auto"
    most_s: MostSeconds = 10.0
    upside_down: UpsideDown = ()


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
