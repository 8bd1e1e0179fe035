"""What a calibration gives: the rig or the clock offsets, its report with checks and numbers, and the files it writes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from posefuse.calibration.clocks.sync import ClockEstimate, clock_figures, clock_settings
from posefuse.calibration.report import CalibrationReport
from posefuse.calibration.targets.coverage import coverage_picture
from posefuse.calibration.verify import Verification
from posefuse.core import CalibrationError, Camera, InputError
from posefuse.core import Rig as CoreRig
from posefuse.core.arrays import Array
from posefuse.core.errors import choices, warn_caller
from posefuse.formats.rig import read_rig, write_rig
from posefuse.foundation.output_file import check_output_file, keep_copy, write_text
from posefuse.foundation.summary import Block, Heading, Table
from posefuse.pipeline.config import read_config

from .rig_and_detector import Rig


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

        Other cameras of an older file of intrinsics stay in it.

        Raises:
            InputError: a file exists and `replace` is not set, or it cannot be written.
        """
        target = _checked(path, replace)
        write_rig_file(target, dataclasses.replace(self.rig, cameras=(*other_intrinsics(target, self.rig.names), *self.rig)))
        for camera in self.rig if report is not None else ():
            whole = Path(str(report))
            page = _checked(whole if len(self.rig) == 1 else whole.with_stem(f"{whole.stem}_{camera.name}"), replace)
            self.reports[camera.name].save(page, _covered(camera, self.cells))
        return target


@dataclass(frozen=True, kw_only=True, eq=False)
class _WithClocks:
    """A calibration that may have found clock offsets.

    Attributes:
        rig: the cameras. report: checks, notes and numbers.
        clocks: clock offsets of the cameras in seconds; None where they are synchronised, or were taken so.
    """

    rig: Rig
    report: CalibrationReport
    clocks: ClockEstimate | None = None

    def summary(self) -> list[Block]:
        """Checks, notes and clocks, for people."""
        return [*self.report.summary(), *clock_blocks(self.rig.names, self.clocks)]

    @property
    def clock_settings(self) -> str:
        """The clock offsets as settings of `posefuse track` (TOML); empty where there is nothing to correct."""
        return "" if self.clocks is None else clock_settings(self.rig.names, self.clocks)


@dataclass(frozen=True, kw_only=True, eq=False)
class RigCalibration(_WithClocks):
    """A rig that passed its checks.

    Attributes:
        rig: the cameras in world coordinates. report: checks, notes and numbers.
        clocks: clock offsets of the cameras in seconds; None where they are synchronised, or were taken so.
        cells: (rows, columns) frames in which a target covered each part of the image, by camera name; empty without a target.
        position_cov_m2: (3, 3) covariance of each camera's place against the first one that was placed, in world coordinates, by
            camera name; empty without a target.
    """

    cells: Mapping[str, Array] = field(default_factory=dict)
    position_cov_m2: Mapping[str, Array] = field(default_factory=dict)

    @property
    def numbers(self) -> dict[str, float]:
        """Measured figures with their units in the names, those of the clocks included."""
        return {**self.report.numbers, **({} if self.clocks is None else clock_figures(self.rig.names, self.clocks))}

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
            self.report.save(_checked(report, replace), pictures, self.rig)
        return target


@dataclass(frozen=True, kw_only=True, eq=False)
class ClockCalibration(_WithClocks):
    """Clock offsets that passed their checks.

    Attributes:
        rig: the calibrated cameras. clocks: offsets and drifts against the first camera. report: checks and numbers.
    """

    clocks: ClockEstimate

    def save(self, path: str | Path) -> Path | None:
        """Write the settings file of a session (``SESSION/posefuse.toml``).

        Returns:
            The path; None where there is nothing to correct, and nothing is written.

        Raises:
            InputError: there are settings already: add `clock_settings` to them. Or it cannot be written.
        """
        if self.clock_settings:
            _checked(path, False)
        return save_clocks(Path(path), self.rig.names, self.clocks)

    def save_report(self, path: str | Path, *, replace: bool = False) -> Path:
        """Write the HTML report; returns its path.

        Raises:
            InputError: the file exists and `replace` is not set, or it cannot be written.
        """
        target = _checked(path, replace)
        self.report.save(target, rig=self.rig)
        return target


@dataclass(frozen=True, kw_only=True, eq=False)
class RigVerification:
    """How well a rig fits to a target of known size.

    Attributes:
        rig: the cameras. report: checks and numbers. measured: errors of lengths and of each camera.
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
        target = _checked(path, replace)
        self.report.save(target, rig=self.rig)
        return target


def write_rig_file(path: Path, rig: CoreRig) -> None:
    """The rig file; an older one is kept as NAME.replaced-TIME."""
    keep_copy(path)
    write_rig(path, rig)


def _checked(path: str | Path, replace: bool) -> Path:
    check_output_file(Path(path), option="path", replace=True if replace else None)
    return Path(path)


def _covered(camera: Camera, cells: Mapping[str, Array]) -> dict[str, Array]:
    if camera.name not in cells:
        return {}
    return {f"{camera.name}: frames per image region": coverage_picture(cells[camera.name], camera.size_wh)}


def other_intrinsics(path: Path, names: Sequence[str]) -> list[Camera]:
    """Cameras of a file of intrinsics except those named; none where it is no such file."""
    try:
        cameras = read_rig(path).cameras if path.is_file() else ()
    except CalibrationError:
        return []
    placed = any(camera.cam_from_world.xyz.any() for camera in cameras)
    return [] if placed else [camera for camera in cameras if camera.name not in names]


def clock_blocks(names: Sequence[str], clocks: ClockEstimate | None) -> list[Block]:
    """A table of all cameras."""
    if clocks is None:
        return []
    rows: list[list[Any]] = []
    for c, name in enumerate(names):
        offset, sigma = clocks.offset_s[c], clocks.offset_sigma_s[c]
        rows.append([name, _both(offset * 1e3, sigma * 1e3, 1)])
        if clocks.drift_sigma.any():
            rows[-1].append(_both(clocks.drift[c] * 1e6, clocks.drift_sigma[c] * 1e6, 0))
    columns = ("camera", "stamps late by, ms", "running fast by, ppm")
    # the only ones without a standard error
    reference = names[int(clocks.offset_sigma_s.argmin())]
    return [Heading(f"clocks, against {reference}"), Table(columns[: len(rows[0])], rows, text=True)]


def _both(value: float, sigma: float, digits: int) -> str:
    return f"{value:+z.{digits}f} ± {sigma:.{digits}f}"


def save_clocks(path: Path, names: Sequence[str], clocks: ClockEstimate | None) -> Path | None:
    """Write the clock offsets that were found as settings that `track` reads; a rig file cannot carry them.

    Returns:
        The file; None when the cameras were synchronised, or there are settings already, which a `UserWarning` states.
    """
    text = "" if clocks is None else clock_settings(names, clocks)
    if not text:
        _warn_of_old_clocks(path, names)
        return None
    if path.exists():
        line = f"{path} exists and is left as it is; add the clock offsets found to it:\n{text}"
        warn_caller(line)
        return None
    write_text(path, text)
    return path


def _warn_of_old_clocks(path: Path, names: Sequence[str]) -> None:
    """Warn where clock offsets of another recording would be applied to cameras that are synchronised."""
    if not path.exists():
        return
    old = read_config(path).cameras
    stale = [name for name in names if name in old and (old[name].offset_s or old[name].drift_ppm)]
    if stale:
        line = (
            f"{path} holds clock offsets of {', '.join(stale)}, but these cameras are synchronised: `posefuse track` would"
            " shift them; remove offset_s and drift_ppm there, or the file"
        )
        warn_caller(line)


def saved_clocks(path: Path, rig: CoreRig) -> dict[str, float]:
    """Clock offsets in s by camera name, from the settings file next to a rig file; empty where there are none.

    Raises:
        InputError: settings of a camera that the rig does not have, or with a drift, which holds for their own recording only.
    """
    cameras = read_config(path).cameras if path.is_file() else {}
    if unknown := sorted(set(cameras) - set(rig.names)):
        raise InputError(f"{path}: no camera {choices(unknown)} in the rig; there are: {choices(rig.names)}")
    drifting = [name for name, one in cameras.items() if one.drift_ppm]
    if drifting:
        raise InputError(f"{path}: the clock of {', '.join(drifting)} drifts; state today's offset_s there, without drift_ppm")
    # settings state what is added to stamps, a clock offset how late they are
    return {name: -one.offset_s for name, one in cameras.items() if one.offset_s}
