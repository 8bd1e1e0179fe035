"""What a calibration gives: the rig or the clock offsets, its report with checks and numbers, and the files it writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from posefuse.calibration.clocks.person import clock_figures
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.report import CalibrationReport
from posefuse.calibration.result_files import clock_settings, heat_map_image, numbered, write_calibration_report, write_rig_file
from posefuse.calibration.targets.coverage import coverage_picture
from posefuse.calibration.verify import Verification
from posefuse.core import Camera
from posefuse.core.arrays import Array
from posefuse.foundation.output_file import check_output_file, write_text

from .rig import Rig

# a full colour of the verification images
_FULL_PX = 3.0


@dataclass(frozen=True, kw_only=True, eq=False)
class IntrinsicsCalibration:
    """Intrinsics that passed their checks.

    Attributes:
        rig: the cameras, all at the origin. reports: by camera name.
        cells: (rows, columns) frames that covered each part of the image, by camera name.
    """

    rig: Rig
    reports: Mapping[str, CalibrationReport]
    cells: Mapping[str, Array]

    def save(self, path: str | Path, *, report: str | Path | None = None, replace: bool = False) -> Path:
        """Write the rig file (TOML), and with `report` one HTML report per camera; returns the rig file's path.

        Raises:
            InputError: a file exists and `replace` is not set, or it cannot be written.
        """
        target = _checked(path, replace)
        write_rig_file(target, self.rig)
        for camera in self.rig if report is not None else ():
            page = _checked(numbered(Path(str(report)), camera.name, len(self.rig)), replace)
            write_calibration_report(page, self.reports[camera.name], _covered(camera, self.cells))
        return target


@dataclass(frozen=True, kw_only=True, eq=False)
class RigCalibration:
    """A rig that passed its checks.

    Attributes:
        rig: the cameras in world coordinates. report: checks, notes and numbers.
        clocks: clock offsets of the cameras in seconds; None where they are synchronised, or were taken so.
        frame_period_s: per camera; empty where no clocks were found.
        cells: (rows, columns) frames in which a target covered each part of the image, by camera name; empty without a target.
        position_cov_m2: (3, 3) covariance of each camera's place against the first one that was placed, in world coordinates, by
            camera name; empty without a target.
    """

    rig: Rig
    report: CalibrationReport
    clocks: ClockEstimate | None = None
    frame_period_s: tuple[float, ...] = ()
    cells: Mapping[str, Array] = field(default_factory=dict)
    position_cov_m2: Mapping[str, Array] = field(default_factory=dict)

    @property
    def numbers(self) -> dict[str, float]:
        """Measured figures with their units in the names, those of the clocks included."""
        return {**self.report.numbers, **({} if self.clocks is None else clock_figures(self.rig.names, self.clocks))}

    @property
    def clock_settings(self) -> str:
        """The clock offsets as settings of `posefuse track` (TOML); empty where there is nothing to correct."""
        return "" if self.clocks is None else clock_settings(self.rig.names, self.clocks)

    def save(self, path: str | Path, *, report: str | Path | None = None, replace: bool = False) -> Path:
        """Write the rig file (TOML), and with `report` the HTML report; returns the rig file's path.

        A rig file cannot carry clock offsets: `clock_settings` belong into the ``posefuse.toml`` of the recordings.

        Raises:
            InputError: a file exists and `replace` is not set, or it cannot be written.
        """
        target = _checked(path, replace)
        write_rig_file(target, self.rig)
        if report is not None:
            pictures = {title: picture for camera in self.rig for title, picture in _covered(camera, self.cells).items()}
            write_calibration_report(_checked(report, replace), self.report, pictures, self.rig)
        return target


@dataclass(frozen=True, kw_only=True, eq=False)
class ClockCalibration:
    """Clock offsets that passed their checks.

    Attributes:
        rig: the calibrated cameras. clocks: offsets and drifts against the first camera. report: checks and numbers.
        frame_period_s: seconds between two frames, per camera.
    """

    rig: Rig
    clocks: ClockEstimate
    report: CalibrationReport
    frame_period_s: tuple[float, ...]

    @property
    def clock_settings(self) -> str:
        """The clock offsets as settings of `posefuse track` (TOML); empty where there is nothing to correct."""
        return clock_settings(self.rig.names, self.clocks)

    def save(self, path: str | Path) -> Path | None:
        """Write the settings file of a session (``SESSION/posefuse.toml``).

        Returns:
            The path; None where there is nothing to correct, and nothing is written.

        Raises:
            InputError: there are settings already: add `clock_settings` to them. Or it cannot be written.
        """
        if not self.clock_settings:
            return None
        target = _checked(path, False)
        write_text(target, self.clock_settings)
        return target

    def save_report(self, path: str | Path, *, replace: bool = False) -> Path:
        """Write the HTML report; returns its path.

        Raises:
            InputError: the file exists and `replace` is not set, or it cannot be written.
        """
        target = _checked(path, replace)
        write_calibration_report(target, self.report, {}, self.rig)
        return target


@dataclass(frozen=True, kw_only=True, eq=False)
class RigVerification:
    """How well a rig fits to a target of known size.

    Attributes:
        rig: the cameras. report: checks and numbers. measured: points, lengths and reprojection errors.
    """

    rig: Rig
    report: CalibrationReport
    measured: Verification

    @property
    def passed(self) -> bool:
        """Whether all checks hold."""
        return not self.report.failed

    def save(self, path: str | Path, *, replace: bool = False) -> Path:
        """Write the HTML report; returns its path.

        Raises:
            InputError: the file exists and `replace` is not set, or it cannot be written.
        """
        pictures = {
            f"{camera.name}: rms reprojection in px": heat_map_image(self.measured.cell_px[i], camera.size_wh, _FULL_PX)
            for i, camera in enumerate(self.rig)
        }
        target = _checked(path, replace)
        write_calibration_report(target, self.report, pictures, self.rig)
        return target


def _checked(path: str | Path, replace: bool) -> Path:
    check_output_file(Path(path), option="path", replace=True if replace else None)
    return Path(path)


def _covered(camera: Camera, cells: Mapping[str, Array]) -> dict[str, Array]:
    if camera.name not in cells:
        return {}
    return {f"{camera.name}: frames per image region": coverage_picture(cells[camera.name], camera.size_wh)}
