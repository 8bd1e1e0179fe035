"""`posefuse calibrate extrinsics`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from .calibrate_options import CameraRecordings, Clocks, Every, MarkerTargetOptions, Millimetres, RigFile, RigOptions, UpsideDown
from .options import FLOOR, Figures, Shown, positive


@Parameter(name="*", group=FLOOR)
@dataclass(frozen=True, kw_only=True)
class FloorOptions:
    """What sets the world coordinates; without it, up is estimated from the cameras."""

    floor_marker: Annotated[int | None, Parameter(metavar="ID")] = None
    """Marker that lies on the floor in the same recordings."""
    floor_side_mm: Millimetres = None
    """Edge of that marker, where it differs from --marker-mm."""
    floor_points: Annotated[Path | None, Parameter(metavar="FILE.toml")] = None
    """Or: pixels per camera of three points of the floor: origin, one along x, one towards y."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ExtrinsicsOptions:
    """How the camera poses are found."""

    intrinsics: RigFile
    """Rig file with the intrinsics."""
    every: Every = 1
    clocks: Clocks = "auto"
    refine_lenses: Annotated[float | None, Parameter(metavar="PERCENT"), positive(100)] = None
    """Refine the intrinsics too; how well their focal lengths are known, in percent, e.g. 0.5."""
    upside_down: UpsideDown = ()


def calibrate_extrinsics(
    *inputs: CameraRecordings,
    target: MarkerTargetOptions = MarkerTargetOptions(),
    floor: FloorOptions = FloorOptions(),
    options: ExtrinsicsOptions,
    files: RigOptions,
    terminal: Shown,
) -> Figures:
    """Find the pose of each camera (extrinsics) from a moving marker object or board.

    Args:
        inputs: Video or folder of images per camera; NAME defaults to the file's name.
    """
    from posefuse.cli.calibrating.target_steps import extrinsics

    return extrinsics(inputs, target, floor, options, files, terminal)
