"""Checks that stand between a calibration and its use: each passed or failed, in words and numbers; and their thresholds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from posefuse.core import CalibrationError, Rig
from posefuse.core.arrays import Array
from posefuse.formats.page import Dots, Images, Line, Page, Plot, Plots, Series, write_page
from posefuse.foundation.output_file import keep_copy
from posefuse.foundation.summary import Block, Cell, Heading, Note, Table

Result = TypeVar("Result")
CheckKind = Literal["record", "lenses", "rig"]


@dataclass(frozen=True)
class Check:
    """One thing that has to hold.

    Attributes:
        name: short, stable (``connectivity``, ``halves agree``).
        passed: whether it holds.
        detail: what was found, where, and the limit.
        remedy: what to do when it does not hold.
        kind: what has to be done again: the calibration of the ``lenses`` or of the ``rig``, else this step (``record``).
    """

    name: str
    passed: bool
    detail: str
    remedy: str = ""
    kind: CheckKind = "record"

    @property
    def line(self) -> str:
        """Detail, and the remedy when there is something to remedy."""
        return self.detail if self.passed or not self.remedy else f"{self.detail}; {self.remedy}"


@dataclass(frozen=True, eq=False)
class CalibrationReport:
    """The quality of a calibration as estimated by itself.

    Attributes:
        subject: what was calibrated.
        checks: in the order they were made.
        notes: what was left out on the way (markers, views), one line each.
        numbers: measured figures with their unit in the name, for tables.
    """

    subject: str
    checks: tuple[Check, ...]
    notes: tuple[str, ...] = ()
    numbers: Mapping[str, float] = field(default_factory=dict)

    @property
    def failed(self) -> tuple[Check, ...]:
        """The checks that do not hold."""
        return tuple(check for check in self.checks if not check.passed)

    def require(self) -> None:
        """Raise RefusedCalibration naming the checks that do not hold; silent when all do."""
        if self.failed:
            raise RefusedCalibration(self)

    def summary(self) -> list[Block]:
        """The checks and the notes, for people."""
        rows = [[Cell("pass", "good") if one.passed else Cell("FAIL", "bad"), one.name, one.line] for one in self.checks]
        notes = [Note(f"note: {note}") for note in self.notes]
        return [Heading(self.subject), Table(["", "check", "found"], rows, text=True), *notes]

    def page(self, images: Mapping[str, Array] | None = None, rig: Rig | None = None) -> Page:
        """For a browser. `images` maps captions to RGB images (H, W, 3); `rig` adds a plan of the cameras."""
        verdict = "passed" if not self.failed else f"refused: {self.failed[0].name}"
        blocks = [Heading("Checks"), *self.summary()[1:]]
        if rig is not None:
            blocks += [Heading("Cameras from above"), Plots([camera_plan_plot(rig)])]
        if images:
            blocks += [Heading("Images"), Images(images)]
        if self.numbers:
            rows = [[name, f"{value:.4g}"] for name, value in self.numbers.items()]
            blocks += [Heading("Numbers"), Table(["number", "value"], rows)]
        return Page(f"{self.subject}: {verdict}", blocks)

    def save(self, path: Path, images: Mapping[str, Array] | None = None, rig: Rig | None = None) -> None:
        """Write its `page` (HTML); an older one is kept as NAME.replaced-TIME. Raises InputError where it cannot be written."""
        keep_copy(path)
        write_page(path, self.page(images, rig))


@dataclass(frozen=True)
class Limits:
    """Thresholds of the checks of a rig from a prop or board, each with its unit and where it comes from.

    "bench" is `bench/calibration_faults.py`. Judgement: set by the author. No fault there fails
    `corner_spread` or `apart_m` alone, and none fails `own_*`, which have tests only.

    Attributes:
        corner_spread_px_per_1000: of a corner coordinate, per 1000 px of image width. The four webcams of `caliscope` leave 0.32.
        agreeing_parts, agreeing_share: the recording is cut into so many parts; in each, a camera must agree by this share of its
            views. Judgement: a third of the time stamps may be wrong.
        position_sigma_share: standard error of a camera's position over the target's usual distance. Judgement: 20 mm of 4 m.
        moved_rad: a step of a camera's view that is no more is not noticed. Judgement: 7 mm at 4 m.
        focal_share: focal lengths that are let free may change by this. Judgement: twice the standard error of intrinsics from a
            board, which is 0.2 to 0.3 % with 0.25 px of noise in the corners.
        centre_rad: and the principal point by this. Judgement; the webcams, whose rig is right, show 2.2 deg, which their halves
            do not confirm.
        bend_px_per_1000: and image points at the rim by distortion, per 1000 px of width. Judgement.
        stretch_share: a board may be longer in one direction by this: printers are true to 0.5 %.
        lens_sigma: none of the four refuses below so many standard errors.
        own_depth_ratio, own_focal_sigma, own_bend_px_per_1000: intrinsics from the recording of the extrinsics need a target that
            was so much farther away at times, and standard errors of focal length (share) and distortion at the rim below these.
            Judgement: what a board gives, and the limits above.
        late_s, drift, late_sigma: clocks of synchronised cameras. 4 ms is 4 mm at 1 m/s.
        apart_m: two cameras nearer than this share a body. Judgement.
        facing_share: of marker views that must show the printed face. Judgement; a mirrored board has 0.
        upside_down_cosine: of the image's up direction with the world's. Judgement: 120 deg.
        target_spread_share: of an image's width, by which a corner must spread over the recording in some camera. Judgement: a
            hand that holds a target still sways by less.
        target_side_m: smallest and largest plausible edge of a marker or square. Prints are 10 mm to 1 m.
        distance_m: smallest and largest plausible distance between target and cameras, of rooms in which people move.
    """

    corner_spread_px_per_1000: float = 1.5
    agreeing_parts: int = 10
    agreeing_share: float = 0.5
    position_sigma_share: float = 0.005
    moved_rad: float = float(np.deg2rad(0.1))
    focal_share: float = 0.005
    centre_rad: float = float(np.deg2rad(1.0))
    bend_px_per_1000: float = 1.0
    stretch_share: float = 0.01
    lens_sigma: float = 6.0
    own_depth_ratio: float = 1.3
    own_focal_sigma: float = 0.003
    own_bend_px_per_1000: float = 0.5
    late_s: float = 0.004
    drift: float = 1e-4
    late_sigma: float = 5.0
    apart_m: float = 0.03
    facing_share: float = 0.9
    upside_down_cosine: float = -0.5
    target_spread_share: float = 0.01
    target_side_m: tuple[float, float] = (0.004, 2.0)
    distance_m: tuple[float, float] = (0.6, 25.0)


LIMITS = Limits()

_LOOK_M = 0.6


def camera_plan_plot(rig: Rig) -> Plot:
    """Cameras seen from above with their viewing directions and heights, and the axes of the world, 1 m long."""
    centres = rig.centres_world()
    forward = np.stack([camera.cam_from_world.matrix()[2] for camera in rig])
    gap = np.full(len(centres), np.nan)
    looks = np.stack([centres[:, :2], centres[:, :2] + _LOOK_M * forward[:, :2], np.stack([gap, gap], axis=-1)], axis=1)
    names = [f"{camera.name} ({centre[2]:.2f} m up)" for camera, centre in zip(rig, centres, strict=True)]
    series: list[Series] = [
        Line("viewing direction", *looks.reshape(-1, 2).T, colour="ink"),
        Dots("cameras", *centres[:, :2].T, colour="c0", labels=names),
        Line("x, 1 m", np.array([0.0, 1]), np.zeros(2), colour="bad"),
        Line("y, 1 m", np.zeros(2), np.array([0.0, 1]), colour="mid"),
    ]
    return Plot("Plan of the cameras", series, x_label="x, m", y_label="y, m", equal=True)


class RefusedCalibration(CalibrationError):
    """A calibration whose own checks do not hold.

    Attributes:
        report: with the checks. kept: what there is all the same: the refused `Calibration`, the intrinsics of
            the other cameras, or None.
    """

    def __init__(self, report: CalibrationReport, kept: Any = None) -> None:
        first, *others = report.failed
        more = f" (also failed: {', '.join(check.name for check in others)})" if others else ""
        super().__init__(f"{report.subject}: {first.name}: {first.line}{more}")
        self.report = report
        self.kept = kept


def after(first: CalibrationReport, solve: Callable[[], Result]) -> Result:
    """What a calibration finds (a dataclass with a `report`), with the checks and notes of its input in front of its own.

    Raises:
        RefusedCalibration: of the calibration, or a check of its input fails; then `kept` is what the calibration found.
    """
    try:
        found: Any = solve()
    except RefusedCalibration as refused:
        raise RefusedCalibration(_joined(first, refused.report), refused.kept) from None
    report = _joined(first, found.report)
    if report.failed:
        raise RefusedCalibration(report, found)
    result: Result = replace(found, report=report)
    return result


def _joined(first: CalibrationReport, then: CalibrationReport) -> CalibrationReport:
    return replace(then, checks=(*first.checks, *then.checks), notes=(*first.notes, *then.notes))
