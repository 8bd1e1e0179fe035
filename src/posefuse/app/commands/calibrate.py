"""`posefuse calibrate`: lenses, places, verification, and targets to print."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from posefuse.app.terminal import Terminal
from posefuse.core import InputError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices

if TYPE_CHECKING:
    from posefuse.calibrate.extrinsics import Calibration
    from posefuse.calibrate.observations import Observations
    from posefuse.calibrate.report import CalibrationReport
    from posefuse.calibrate.targets import Target
    from posefuse.core import Camera, Rig, Source

SUMMARY = "calibrate cameras from recordings of a board, a marker prop or a person; verify; print targets"
TARGETS = ("markers", "charuco", "chessboard", "aruco-board")
# a board that gives the focal length to a per cent gives k1 and k2 to about this
_LENS_PER_PERCENT = 0.02


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """One subcommand per step of a calibration."""
    steps = parser.add_subparsers(metavar="STEP", required=True, dest="step")
    one = steps.add_parser("intrinsics", help="lens of each camera from views of a board")
    _add_target(one, "charuco")
    _add_inputs(one)
    one.add_argument("--out", type=Path, required=True, metavar="FILE", help="rig file to write")
    two = steps.add_parser("extrinsics", help="places of the cameras from a waved prop of markers or a board")
    _add_target(two, "markers")
    _add_inputs(two)
    two.add_argument("--intrinsics", type=Path, required=True, metavar="FILE", help="rig file with the lenses")
    two.add_argument("--out", type=Path, required=True, metavar="FILE", help="rig file to write")
    two.add_argument("--clocks", choices=("auto", "together", "offset", "drift"), default="auto",
                     help="estimate the cameras' clocks: never (together), always, or when needed (auto)")  # fmt: skip
    two.add_argument("--floor-marker", type=int, metavar="ID", help="marker of the same recordings that lies on the floor")
    two.add_argument("--floor-side-mm", type=float, metavar="MM", help="side of that marker, when it differs")
    two.add_argument("--refine-lenses", type=float, metavar="PERCENT",
                     help="let the lenses move too; how well their focal lengths are known, e.g. 0.5")  # fmt: skip
    two.add_argument("--upside-down", nargs="*", default=[], metavar="CAMERA", help="cameras that really hang upside down")
    live = steps.add_parser("guide", help="at the cameras: what the waving has covered, and when it is enough")
    _add_target(live, "markers")
    live.add_argument("--intrinsics", type=Path, required=True, metavar="FILE", help="rig file with the cameras' names")
    live.add_argument("--source", action="append", required=True, metavar="CAMERA=KIND:WHERE", help="as in `posefuse live`")
    live.add_argument("--duration", type=float, metavar="S", help="stop after so many seconds at the latest")
    person = steps.add_parser("person", help="places of the cameras from a walking person's 2D poses")
    person.add_argument("poses", nargs="+", metavar="NAME=DIR", help="folder of OpenPose JSON files per camera")
    person.add_argument("--intrinsics", type=Path, required=True, metavar="FILE", help="rig file with the lenses")
    person.add_argument("--rate-hz", type=float, required=True, help="frame rate of the poses")
    person.add_argument("--height-m", type=float, required=True, help="stature of the person, which sets the scale")
    person.add_argument("--out", type=Path, required=True, metavar="FILE", help="rig file to write")
    check = steps.add_parser("verify", help="millimetres and pixels of a rig, with a marker or board held anywhere")
    _add_target(check, "charuco")
    _add_inputs(check)
    check.add_argument("--rig", type=Path, required=True, metavar="FILE", help="rig file to verify")
    check.add_argument("--offset-ms", nargs="*", default=[], metavar="CAMERA=MS", help="clocks found by `extrinsics`")
    sheets = steps.add_parser("print", help="PDF of a target at its true size")
    sheets.add_argument("--cube", action="store_true", help="six markers for a cube")
    _add_target(sheets, "charuco")
    sheets.add_argument("--page", default="a4", help="a4, a3, a2, a1, a0 or letter")
    sheets.add_argument("--out", type=Path, required=True, metavar="FILE", help="PDF to write")
    for step in (one, two, person, check):
        step.add_argument("--report", type=Path, metavar="FILE", help="HTML report, written also when the result is refused")


def _add_target(parser: argparse.ArgumentParser, default: str) -> None:
    group = parser.add_argument_group("target")
    group.add_argument("--target", choices=TARGETS, default=default)
    group.add_argument("--columns", type=int, help="squares across (charuco), inner corners (chessboard), markers (aruco-board)")
    group.add_argument("--rows", type=int, help="the same, down")
    group.add_argument("--square-mm", type=float, help="edge of a square")
    group.add_argument("--marker-mm", type=float, help="edge of a marker's black square")
    group.add_argument("--gap-mm", type=float, help="white between two markers (aruco-board)")
    group.add_argument("--dictionary", default="DICT_4X4_50", help="OpenCV's name of the marker dictionary")
    group.add_argument("--ids", type=int, nargs="*", default=[], help="markers of the prop (markers); default all")
    group.add_argument("--inverted", action="store_true", help="colours exchanged")
    group.add_argument("--legacy", action="store_true", help="ChArUco layout of OpenCV before 4.6")


def _add_inputs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "inputs", nargs="+", metavar="NAME=PATH", help="video or folder of images per camera; NAME defaults to the file's"
    )
    parser.add_argument("--every", type=int, default=1, metavar="N", help="look at every Nth frame")


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Do the step; a refused result is an error, after its report is written."""
    steps = {"intrinsics": _intrinsics, "extrinsics": _extrinsics, "guide": _guide, "person": _person, "verify": _verify,
             "print": _print}  # fmt: skip
    return {"step": args.step, **steps[args.step](args, terminal)}


def _intrinsics(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    from posefuse.calibrate.coverage import coverage_picture
    from posefuse.calibrate.detection import observe
    from posefuse.calibrate.intrinsics import calibrate_intrinsics
    from posefuse.core import Rig
    from posefuse.files.rig import write_rig

    target, found = _target(args), []
    for source in _sources(args.inputs):
        observations = _seen(observe(source, target, args.every), source, target)
        with _reported(args):
            found.append(calibrate_intrinsics(observations, target))
        _show(found[-1].report, terminal)
    rig = Rig(tuple(one.camera for one in found), world_set_by="lenses only")
    write_rig(args.out, rig)
    for one in found:
        picture = {f"{one.camera.name}: frames per image region": coverage_picture(one.cells, one.camera.size_wh)}
        _write_report(_numbered(args.report, one.camera.name, len(found)), one.report, picture)
    return {"rig": str(args.out), "cameras": {one.camera.name: dict(one.report.numbers) for one in found}}


def _extrinsics(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    from dataclasses import replace

    from posefuse.calibrate.coverage import coverage_picture
    from posefuse.calibrate.detection import observe
    from posefuse.calibrate.extrinsics import calibrate_extrinsics
    from posefuse.calibrate.observations import joined
    from posefuse.calibrate.pipeline import Options
    from posefuse.calibrate.targets import Markers
    from posefuse.calibrate.world import FloorTile
    from posefuse.files.rig import read_rig, write_rig

    target, intrinsics = _target(args), read_rig(args.intrinsics)
    sources = _sources(args.inputs)
    seen = []
    with terminal.progress("looking for the target") as advance:
        for i, source in enumerate(sources):
            seen.append(observe(source, target, args.every))
            advance(i + 1, len(sources))
    observations = joined(seen)
    covered = _write_coverage(args.out, observations, terminal)
    world = None
    if args.floor_marker is not None:
        if not isinstance(target, Markers):
            raise InputError("--floor-marker: needs --target markers, of the same dictionary")
        tile = replace(target, side_m=(args.floor_side_mm or target.side_m * 1e3) / 1e3, ids=(args.floor_marker,))
        world = FloorTile(observations.of_patches([args.floor_marker]), tile, args.floor_marker)
        observations = observations.rows(observations.patch != args.floor_marker)
    cameras = tuple(intrinsics[source.camera] for source in sources)
    with _reported(args):
        options = Options(clocks=args.clocks, lens_sigma=_lens_sigma(args.refine_lenses, cameras))
        found = calibrate_extrinsics(observations, cameras, target, options, world, tuple(args.upside_down))
    _show(found.report, terminal)
    write_rig(args.out, found.rig)
    pictures = {
        f"{camera.name}: frames per image region": coverage_picture(found.coverage.cells[i], camera.size_wh)
        for i, camera in enumerate(found.rig)
    }
    _write_report(args.report, found.report, pictures, found.rig)
    settings = _write_clocks(args.out, found, terminal)
    return {
        "rig": str(args.out),
        "coverage": str(covered),
        "settings": settings and str(settings),
        **found.report.numbers,
        "notes": list(found.report.notes),
    }


def _write_coverage(rig_path: Path, observations: Observations, terminal: Terminal) -> Path:
    """The picture of what the waving has met, before the solve: it is needed most when that refuses."""
    import cv2

    from posefuse.calibrate.coverage import coverage, coverage_sheet

    found, path = coverage(observations), rig_path.with_name(f"{rig_path.stem}_coverage.png")
    _, png = cv2.imencode(".png", cv2.cvtColor(coverage_sheet(found, observations.sizes_wh), cv2.COLOR_RGB2BGR))
    path.write_bytes(png.tobytes())
    terminal.note(f"{path}: {found.advice()}")
    return path


def _write_clocks(rig_path: Path, found: Calibration, terminal: Terminal) -> Path | None:
    """The clocks that were found, as settings that `posefuse track` reads; a rig file cannot carry them.

    A frame stamped s was taken at s - offset - drift * (s - middle), and `track` adds its settings: the signs turn.
    Returns None when the cameras were in step, or the settings are somebody's already.
    """
    from posefuse.app.config import CONFIG_FILE

    if not found.delay_s.any():
        return None
    clocks = zip(found.rig.names, found.delay_s.tolist(), strict=True)
    text = "\n".join(_clock_settings(name, offset, drift, found.middle_ns / 1e9) for name, (offset, drift) in clocks)
    path = rig_path.with_name(CONFIG_FILE)
    if path.exists():
        terminal.warn(f"{path} is there already and is left as it is; the clocks found belong into it:\n{text}")
        return None
    path.write_text(text, encoding="utf-8")
    terminal.note(f"{path}: clocks of the cameras, for `posefuse track` of recordings made together with these")
    return path


def _lens_sigma(percent: float | None, cameras: Sequence[Camera]) -> tuple[float, ...] | None:
    """Standard errors of fx, fy, cx, cy (px), k1, k2 for lenses whose focal length is known to `percent`."""
    if percent is None:
        return None
    if not percent > 0:
        raise InputError(f"--refine-lenses: expected > 0 percent, got {percent:g}")
    focal_px = percent / 100 * float(np.mean([camera.K[0, 0] for camera in cameras]))
    return (focal_px,) * 4 + (_LENS_PER_PERCENT * percent,) * 2


def _clock_settings(camera: str, offset_s: float, drift: float, middle_s: float) -> str:
    """One camera's table in `posefuse.toml`; drift only where it was estimated."""
    table = f"[cameras.{json.dumps(camera)}]\noffset_s = {drift * middle_s - offset_s:.6f}\n"
    return table + (f"drift_ppm = {-drift * 1e6:.3f}\n" if drift else "")


def _person(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    from posefuse.calibrate.person import KnownLength, calibrate_from_person, person_views
    from posefuse.detect.openpose import read_openpose_folder
    from posefuse.files.rig import read_rig, write_rig

    intrinsics = read_rig(args.intrinsics)
    folders = dict(_named(text) for text in args.poses)
    poses = {name: list(read_openpose_folder(path, name).frames(args.rate_hz)) for name, path in folders.items()}
    cameras = tuple(intrinsics[name] for name in folders)
    with _reported(args):
        found = calibrate_from_person(person_views(poses), cameras, KnownLength(stature_m=args.height_m))
    _show(found.report, terminal)
    write_rig(args.out, found.rig)
    _write_report(args.report, found.report, {}, found.rig)
    return {"rig": str(args.out), **found.report.numbers}


def _guide(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    from posefuse.app.guiding import guide
    from posefuse.app.live.inputs import inputs_from_arguments
    from posefuse.calibrate.guidance import Guidance
    from posefuse.files.rig import read_rig

    def tell(state: Guidance) -> None:
        covered = state.coverage
        rows = [(name, f"{share:.0%}", *counts) for name, share, counts in
                zip(covered.cameras, covered.share, covered.together.tolist(), strict=True)]  # fmt: skip
        terminal.table("seen together with", ("camera", "covered", *covered.cameras), rows)
        terminal.note(state.words)

    inputs = inputs_from_arguments(args.source, read_rig(args.intrinsics))
    found = guide(inputs, _target(args), tell, args.duration)
    covered = {name: float(share) for name, share in zip(found.coverage.cameras, found.coverage.share, strict=True)}
    return {"enough": found.enough, "covered": covered, "next": found.words}


def _verify(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    from posefuse.calibrate.detection import observe_all
    from posefuse.calibrate.report_html import heat_picture
    from posefuse.calibrate.verify import verify
    from posefuse.files.rig import read_rig

    target, rig = _target(args), read_rig(args.rig)
    found = verify(rig, observe_all(_sources(args.inputs), target, args.every), target, _late_s(args.offset_ms, rig))
    _show(found.report, terminal)
    pictures = {
        f"{camera.name}: rms reprojection in px": heat_picture(found.cell_px[i], camera.size_wh, 3.0)
        for i, camera in enumerate(rig)
    }
    _write_report(args.report, found.report, pictures, rig)
    found.report.require()
    return dict(found.report.numbers)


def _print(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    from posefuse.calibrate.printing import board_sheet, cube_sheets, marker_sheets, write_pdf
    from posefuse.calibrate.targets import Chessboard, Markers

    if args.cube:
        args.target = "markers"
    target = _target(args)
    if isinstance(target, Chessboard):
        raise InputError("print: a plain chessboard is not offered; a ChArUco board does all it does, and more")
    if args.cube and isinstance(target, Markers):
        sheets = cube_sheets(target, page=args.page)
    elif isinstance(target, Markers):
        sheets = marker_sheets(target, target.ids or (0,), args.page)
    else:
        sheets = [board_sheet(target, args.page)]
    write_pdf(args.out, sheets)
    terminal.note(f"{args.out}: {len(sheets)} pages; print at 100 % and measure the ruler")
    return {"pdf": str(args.out), "pages": len(sheets)}


def _target(args: argparse.Namespace) -> Target:
    from posefuse.calibrate.targets import ArucoBoard, Charuco, Chessboard, Markers

    def need(*names: str) -> list[Any]:
        missing = [f"--{name.replace('_', '-')}" for name in names if getattr(args, name) is None]
        if missing:
            raise InputError(f"--target {args.target}: missing {', '.join(missing)}")
        return [getattr(args, name) / 1e3 if name.endswith("_mm") else getattr(args, name) for name in names]

    if args.target == "markers":
        (side,) = need("marker_mm")
        return Markers(side, args.dictionary, tuple(args.ids), args.inverted)
    if args.target == "charuco":
        columns, rows, square, marker = need("columns", "rows", "square_mm", "marker_mm")
        return Charuco(columns, rows, square, marker, args.dictionary, args.inverted, args.legacy)
    if args.target == "chessboard":
        columns, rows, square = need("columns", "rows", "square_mm")
        return Chessboard(columns, rows, square)
    columns, rows, side, gap = need("columns", "rows", "marker_mm", "gap_mm")
    return ArucoBoard(columns, rows, side, gap, args.dictionary, args.ids[0] if args.ids else 0, args.inverted)


def _late_s(offsets: list[str], rig: Rig) -> Array:
    late_s = np.zeros(len(rig))
    for text in offsets:
        name, _, value = text.partition("=")
        try:
            late_s[rig.names.index(rig[name].name)] = float(value) / 1e3
        except ValueError:
            raise InputError(f"--offset-ms {text}: expected CAMERA=MILLISECONDS") from None
    return late_s


def _named(text: str) -> tuple[str, Path]:
    name, equals, path = text.partition("=")
    return (name, Path(path)) if equals else (Path(text).stem, Path(text))


def _sources(inputs: list[str]) -> list[Source]:
    from posefuse.sources import VIDEO_SUFFIXES, ImagesConfig, VideoConfig

    sources: list[Source] = []
    for text in inputs:
        name, path = _named(text)
        if not path.exists():
            raise InputError(f"{path}: no such video or folder of images")
        if path.is_dir():
            sources.append(ImagesConfig(path, name).build())
        elif path.suffix.lower() in VIDEO_SUFFIXES:
            sources.append(VideoConfig(path, name).build())
        else:
            raise InputError(f"{path}: expected a folder of images or a video ({choices(VIDEO_SUFFIXES)})")
    return sources


def _seen(observations: Any, source: Source, target: Target) -> Any:
    """The observations, unless there are none: then say why."""
    if len(observations):
        return observations
    import itertools

    import cv2

    from posefuse.calibrate.detection import why_nothing
    from posefuse.core import CalibrationError

    frames = [cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY) for frame in itertools.islice(source.frames(), 12)]
    raise CalibrationError(
        f"camera {source.camera}: the target is in none of {observations.frame_count[0]} frames: {why_nothing(frames, target)}"
    )


@contextmanager
def _reported(args: argparse.Namespace) -> Iterator[None]:
    """Write the report of a refused calibration before the error goes on."""
    from posefuse.calibrate.report import RefusedCalibration

    try:
        yield
    except RefusedCalibration as refused:
        _write_report(args.report, refused.report, {})
        raise


def _write_report(path: Path | None, report: CalibrationReport, pictures: Mapping[str, Any], rig: Rig | None = None) -> None:
    from posefuse.calibrate.report_html import html_page

    if path is not None:
        path.write_text(html_page(report, pictures, rig), encoding="utf-8")


def _numbered(path: Path | None, name: str, count: int) -> Path | None:
    return path if path is None or count == 1 else path.with_stem(f"{path.stem}_{name}")


def _show(report: CalibrationReport, terminal: Terminal) -> None:
    rows = [("pass" if check.passed else "FAIL", check.name, check.line) for check in report.checks]
    terminal.table(report.subject, ("", "check", "found"), rows)
    for note in report.notes:
        terminal.note(f"note: {note}")
