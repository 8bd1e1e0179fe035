"""A calibration's report as a page: checks, numbers, coverage images, a plan of the cameras."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from posefuse.core import Rig
from posefuse.core.arrays import Array
from posefuse.formats.page import Dots, Heading, Images, Line, Page, Plot, Plots, Series, Table

from .report import CalibrationReport

_LOOK_M = 0.6


def calibration_page(report: CalibrationReport, images: Mapping[str, Array] | None = None, rig: Rig | None = None) -> Page:
    """The page. `images` maps captions to RGB images (H, W, 3); `rig` adds a plan of the cameras."""
    verdict = "passed" if not report.failed else f"refused: {report.failed[0].name}"
    blocks = [Heading("Checks"), *report.summary()[1:]]
    if rig is not None:
        blocks += [Heading("Cameras from above"), Plots([camera_plan_plot(rig)])]
    if images:
        blocks += [Heading("Images"), Images(images, lossless=True)]
    if report.numbers:
        rows = [[name, f"{value:.4g}"] for name, value in report.numbers.items()]
        blocks += [Heading("Numbers"), Table(["number", "value"], rows)]
    return Page(f"{report.subject}: {verdict}", blocks)


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


def heat_map_image(values: Array, size_wh: tuple[int, int], full: float) -> Array:
    """RGB image (H, W, 3) of values (rows, columns) over an image: green 0, red `full` and more, grey NaN."""
    level = np.clip(np.nan_to_num(values) / full, 0, 1)[..., None]
    colours = np.array([40, 170, 80]) * (1 - level) + np.array([200, 60, 40]) * level
    colours = np.where(np.isnan(values)[..., None], 128, colours).astype(np.uint8)
    picture = cv2.resize(colours, size_wh, interpolation=cv2.INTER_NEAREST)
    rows, columns = values.shape
    for row, column in np.argwhere(np.isfinite(values)):
        at = (round((column + 0.15) * size_wh[0] / columns), round((row + 0.6) * size_wh[1] / rows))
        cv2.putText(picture, f"{values[row, column]:.1f}", at, cv2.FONT_HERSHEY_SIMPLEX, size_wh[0] / 1600, (255, 255, 255), 1)
    return np.asarray(picture)
