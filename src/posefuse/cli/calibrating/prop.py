"""The steps with a board or a prop of markers: lenses, places, verification, and sheets to print."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from posefuse.calibration.checks.verify import verify
from posefuse.calibration.extrinsics.limits import LIMITS
from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.extrinsics.target import calibrate_extrinsics
from posefuse.calibration.extrinsics.world import FloorTile, ThreePoints, WorldRule
from posefuse.calibration.intrinsics.board import calibrate_intrinsics
from posefuse.calibration.report_page import heat_picture
from posefuse.calibration.targets.corners import Observations, joined
from posefuse.calibration.targets.coverage import coverage_picture
from posefuse.calibration.targets.detection import observe, observe_all
from posefuse.calibration.targets.kinds import Chessboard, Markers, Target
from posefuse.calibration.targets.printing import board_sheet, cube_sheets, marker_sheets, write_pdf
from posefuse.cli.terminal import Terminal
from posefuse.core import Camera, InputError, Rig
from posefuse.formats.rig import read_placed_rig, read_rig
from posefuse.foundation.atomic import atomic_file
from posefuse.foundation.output_file import keep_copy
from posefuse.pipeline.config import CONFIG_FILE

from .floor_points import read_floor_points
from .inputs import late_s, seen_or_why_not, sources_from_arguments, target_from_arguments
from .results import (
    clocks_of,
    kept_if_asked,
    numbered,
    reported,
    show,
    write_clocks,
    write_coverage,
    write_report,
    write_rig_file,
)

# a board that gives the focal length to a per cent gives k1 and k2 to about this
_LENS_PER_PERCENT = 0.02


def intrinsics(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Lens of each camera from its views of a board: rig file without places, and reports."""
    target, found = target_from_arguments(args), []
    for source in sources_from_arguments(args.inputs):
        observations = seen_or_why_not(observe(source, target, args.every), source, target)
        with reported(args):
            found.append(calibrate_intrinsics(observations, target))
        show(found[-1].report, terminal)
    rig = Rig(tuple(one.camera for one in found), world_set_by="lenses only")
    write_rig_file(args.out, rig)
    for one in found:
        picture = {f"{one.camera.name}: frames per image region": coverage_picture(one.cells, one.camera.size_wh)}
        write_report(numbered(args.report, one.camera.name, len(found)), one.report, picture)
    terminal.next(f"posefuse calibrate extrinsics --help (with --intrinsics {args.out})", "where the cameras stand")
    return {"rig": str(args.out), "cameras": {one.camera.name: dict(one.report.numbers) for one in found}}


def extrinsics(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Places of the cameras from a waved prop or board: rig file, coverage picture, report, and clocks where they count."""
    target, lenses = target_from_arguments(args), read_rig(args.intrinsics)
    # all that may be wrong with the command line, before minutes of looking
    points = _floor_points(args, target)
    sources = sources_from_arguments(args.inputs)
    cameras = tuple(lenses[source.camera] for source in sources)
    seen = []
    with terminal.progress("looking for the target") as advance:
        for i, source in enumerate(sources):
            seen.append(observe(source, target, args.every))
            advance(i + 1, len(sources))
    for source, views in zip(sources, seen, strict=True):
        seen_or_why_not(views, source, target)
    observations = joined(seen)
    covered = write_coverage(args.out, observations, terminal)
    observations, world = (observations, points) if points else _floor_marker(args, observations, target)
    limits = replace(LIMITS, distance_m=(0.0, np.inf)) if args.any_size else LIMITS
    options = Options(clocks=args.clocks, lens_sigma=_lens_sigma(args.refine_lenses, cameras), limits=limits)
    with reported(args):
        found = kept_if_asked(
            lambda: calibrate_extrinsics(observations, cameras, target, options, world, tuple(args.upside_down)),
            args.keep_refused, terminal,
        )  # fmt: skip
    show(found.report, terminal)
    write_rig_file(args.out, found.rig)
    pictures = {
        f"{camera.name}: frames per image region": coverage_picture(found.coverage.cells[i], camera.size_wh)
        for i, camera in enumerate(found.rig)
    }
    write_report(args.report, found.report, pictures, found.rig)
    settings = write_clocks(args.out.with_name(CONFIG_FILE), found.rig.names, clocks_of(found), terminal)
    terminal.next("posefuse calibrate verify --help", f"check {args.out} with a target it was not made from")
    return {
        "rig": str(args.out),
        "coverage": str(covered),
        "settings": settings and str(settings),
        **found.report.numbers,
        "notes": list(found.report.notes),
    }


def _floor_points(args: argparse.Namespace, target: Target) -> ThreePoints | None:
    """Three marked points that set the world, if they do."""
    if args.floor_marker is not None and not isinstance(target, Markers):
        raise InputError("--floor-marker: needs --target markers, of the same dictionary")
    if args.floor_points is None:
        return None
    if args.floor_marker is not None:
        raise InputError("--floor-points, --floor-marker: one of the two sets the world")
    return read_floor_points(args.floor_points)


def _floor_marker(args: argparse.Namespace, observations: Observations, target: Target) -> tuple[Observations, WorldRule | None]:
    """The prop's observations alone, and the marker on the floor that sets the world; None guesses up from the cameras."""
    if args.floor_marker is None or not isinstance(target, Markers):
        return observations, None
    tile = replace(target, side_m=(args.floor_side_mm or target.side_m * 1e3) / 1e3, ids=(args.floor_marker,))
    world = FloorTile(observations.of_patches([args.floor_marker]), tile, args.floor_marker)
    return observations.rows(observations.patch != args.floor_marker), world


def _lens_sigma(percent: float | None, cameras: Sequence[Camera]) -> tuple[float, ...] | None:
    """Standard errors of fx, fy, cx, cy (px), k1, k2 for lenses whose focal length is known to `percent`."""
    if percent is None:
        return None
    if not percent > 0:
        raise InputError(f"--refine-lenses: expected > 0 percent, got {percent:g}")
    focal_px = percent / 100 * float(np.mean([camera.K[0, 0] for camera in cameras]))
    return (focal_px,) * 4 + (_LENS_PER_PERCENT * percent,) * 2


def verify_rig(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Millimetres and pixels of a rig, from a target that it was not made from."""
    target, rig = target_from_arguments(args), read_placed_rig(args.rig)
    found = verify(rig, observe_all(sources_from_arguments(args.inputs), target, args.every), target, late_s(args.offset_ms, rig))
    show(found.report, terminal)
    pictures = {
        f"{camera.name}: rms reprojection in px": heat_picture(found.cell_px[i], camera.size_wh, 3.0)
        for i, camera in enumerate(rig)
    }
    write_report(args.report, found.report, pictures, rig)
    found.report.require()
    terminal.next(f"put {args.rig} beside your videos and run: posefuse track SESSION --out RESULT", "the rig is good")
    return dict(found.report.numbers)


def print_target(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """A target at its true size as a PDF."""
    if args.cube:
        args.target = "markers"
    target = target_from_arguments(args)
    if isinstance(target, Chessboard):
        raise InputError("print: a plain chessboard is not offered; a ChArUco board does all it does, and more")
    if args.cube and isinstance(target, Markers):
        sheets = cube_sheets(target, page=args.page)
    elif isinstance(target, Markers):
        sheets = marker_sheets(target, target.ids or (0,), args.page)
    else:
        sheets = [board_sheet(target, args.page)]
    keep_copy(args.out)
    with atomic_file(args.out) as temporary:
        write_pdf(temporary, sheets)
    terminal.note(f"{args.out}: {len(sheets)} pages; print at 100 % and measure the ruler")
    terminal.next("posefuse calibrate intrinsics --help", "film the target with every camera, and find their intrinsics")
    return {"pdf": str(args.out), "pages": len(sheets)}
