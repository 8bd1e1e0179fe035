"""The steps with a board or markers: intrinsics, extrinsics, verification, and sheets to print."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from posefuse.api.calibrate import calibrate_extrinsics, calibrate_intrinsics, observe_target, verify
from posefuse.api.calibration_results import IntrinsicsCalibration
from posefuse.api.rig import rig_of
from posefuse.calibration.extrinsics.floor import FloorMarker, check_floor, read_floor_points, with_floor
from posefuse.calibration.extrinsics.world import ThreePoints
from posefuse.calibration.report import RefusedCalibration
from posefuse.calibration.result_files import coverage_path, write_coverage
from posefuse.calibration.settings import TargetDescription
from posefuse.calibration.targets.kinds import Chessboard, Markers, Target, described_target, read_target, write_target
from posefuse.calibration.targets.printing import board_sheets, cube_sheets, marker_sheets, write_pdf
from posefuse.calibration.targets.recordings import open_sources, require_target_seen
from posefuse.cli.command_options import ExtrinsicsOptions, IntrinsicsOptions, PrintOptions, VerifyOptions
from posefuse.cli.terminal import Terminal
from posefuse.core import CalibrationError, Camera, InputError
from posefuse.formats.rig import read_placed_rig, read_rig
from posefuse.foundation.output_file import atomic_file, keep_copy
from posefuse.pipeline.config import CONFIG_FILE

from .inputs import check_files, clock_offsets_s, clocks_beside, option_name, recordings_of
from .showing import Asked, reported, show_report, write_clocks


def intrinsics(inputs: Sequence[str], options: IntrinsicsOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Intrinsics of each camera from its views of a board: rig file without poses, and reports."""
    outputs = (("--out", options.out), ("--report", options.report))
    check_files((*inputs, options.target), outputs, force=options.force)
    recordings, kind = recordings_of(inputs), read_target(options.target)
    with reported(options.report, Asked(step="intrinsics", inputs=inputs, options=options)):
        try:
            with terminal.stages() as progress:
                found = calibrate_intrinsics(recordings, target=kind, every=options.every, progress=progress)
        except RefusedCalibration as refused:
            if refused.kept is not None:
                _save_lenses(refused.kept, options, terminal)
            raise
    _save_lenses(found, options, terminal)
    terminal.next(
        f"posefuse calibrate guide --target CUBE.toml --intrinsics {options.out} --source CAMERA=KIND:WHERE ... --record SESSION",
        "move a target where two cameras see it; `calibrate extrinsics` then finds the poses of the cameras",
    )
    return {"rig": str(options.out), "cameras": {name: dict(report.numbers) for name, report in found.reports.items()}}


def _save_lenses(found: IntrinsicsCalibration, options: IntrinsicsOptions, terminal: Terminal) -> None:
    """Reports and rig file; cameras of an older file that were not calibrated now stay in it."""
    for report in found.reports.values():
        show_report(report, terminal)
    stay = _lenses_of_others(options.out, found.rig.names)
    if stay:
        found = replace(found, rig=rig_of(replace(found.rig, cameras=(*stay, *found.rig))))
    found.save(options.out, report=options.report, replace=options.force)
    words = f"; {', '.join(camera.name for camera in stay)} as before" if stay else ""
    terminal.note(f"{options.out}: intrinsics of {', '.join(found.reports)}{words}")


def _lenses_of_others(path: Path, names: Sequence[str]) -> list[Camera]:
    """Cameras of a file of intrinsics except those named; none where it is no such file."""
    try:
        cameras = read_rig(path).cameras if path.is_file() else ()
    except CalibrationError:
        return []
    placed = any(camera.cam_from_world.xyz.any() for camera in cameras)
    return [] if placed else [camera for camera in cameras if camera.name not in names]


def extrinsics(inputs: Sequence[str], options: ExtrinsicsOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Poses of the cameras from a moving target: rig file, coverage image, report, and clocks where they count."""
    picture = coverage_path(options.out)
    read = (*inputs, options.target, options.intrinsics, options.floor_points)
    check_files(read, (("--out", options.out), ("--report", options.report)), force=options.force)
    # a refused run leaves the image, and must not stop the next one; an older image is kept as a copy
    check_files(read, (("--out", picture),), force=True)
    # everything that may be wrong with the command line, before minutes of work
    kind = read_target(options.target)
    lenses = None if options.intrinsics is None else read_rig(options.intrinsics)
    world = _floor(options, kind)
    recordings = recordings_of(inputs)
    if lenses is not None:
        for name in recordings:
            lenses[name]
    with terminal.stages() as progress:
        seen = observe_target(recordings, target=with_floor(kind, world), every=options.every, progress=progress)
    # before the solve: it is needed most when that refuses
    terminal.note(f"{picture}: {write_coverage(picture, seen).advice()}")
    require_target_seen(seen, open_sources(recordings), kind)
    with reported(options.report, Asked(step="extrinsics", inputs=inputs, options=options)):
        found = calibrate_extrinsics(
            seen,
            intrinsics=lenses,
            target=kind,
            clocks=options.clocks,
            floor=world,
            focal_known_to_percent=options.refine_lenses,
            upside_down=options.upside_down,
            any_size=options.any_size,
            keep_refused=options.keep_refused,
        )
    if found.report.failed:
        failed = ", ".join(check.name for check in found.report.failed)
        terminal.warn(f"refused ({failed}); kept all the same (--keep-refused), and marked as refused in the file")
    show_report(found.report, terminal)
    found.save(options.out, report=options.report, replace=options.force)
    settings = write_clocks(options.out.with_name(CONFIG_FILE), found.rig.names, found.clocks, terminal)
    terminal.next(
        f"posefuse calibrate verify SESSION --target BOARD.toml --rig {options.out}",
        "with a target that the rig was not made from",
    )
    return {
        "rig": str(options.out),
        "coverage": str(picture),
        "settings": settings and str(settings),
        **found.report.numbers,
        "notes": list(found.report.notes),
    }


def _floor(options: ExtrinsicsOptions, target: Target) -> FloorMarker | ThreePoints | None:
    """What sets the world coordinates; None estimates up from the cameras."""
    if options.floor_marker is not None and options.floor_points is not None:
        raise InputError("--floor-points, --floor-marker: one of the two sets the world")
    if options.floor_points is not None:
        return read_floor_points(options.floor_points)
    if options.floor_marker is None:
        return None
    side_m = None if options.floor_side_mm is None else options.floor_side_mm / 1e3
    marker = FloorMarker(options.floor_marker, side_m)
    check_floor(marker, target)
    return marker


def verify_rig(inputs: Sequence[str], options: VerifyOptions, terminal: Terminal) -> Mapping[str, Any]:
    """Millimetres and pixels of a rig, from a target that it was not made from."""
    check_files((*inputs, options.target, options.rig), (("--report", options.report),), force=options.force)
    kind, rig = read_target(options.target), read_placed_rig(options.rig)
    settings = options.rig.with_name(CONFIG_FILE)
    late_s = clock_offsets_s(options.offset_ms, rig) if options.offset_ms else clocks_beside(settings, rig)
    if late_s and not options.offset_ms:
        terminal.note(f"clock offsets of {', '.join(late_s)} from {settings}")
    with terminal.stages() as progress:
        found = verify(rig, recordings_of(inputs), target=kind, every=options.every, clock_offset_s=late_s, progress=progress)
    show_report(found.report, terminal)
    if options.report is not None:
        found.save(options.report, replace=options.force)
    with reported(None, Asked(step="verify", inputs=inputs, options=options)):
        found.report.require()
    terminal.next(f"put {options.rig} into the folder of your videos: posefuse track SESSION --out RESULT", "the rig is good")
    return dict(found.report.numbers)


def print_target(options: PrintOptions, terminal: Terminal) -> Mapping[str, Any]:
    """A target at its true size as a PDF."""
    described = options.out.with_suffix(".toml")
    check_files((), (("--out", options.out), ("--out", described)), force=options.force)
    kind = _described(options)
    if isinstance(kind, Chessboard):
        raise InputError("print: a plain chessboard is not offered; a ChArUco board does all it does, and more")
    if options.cube and isinstance(kind, Markers):
        sheets = cube_sheets(kind, page=options.page)
    elif isinstance(kind, Markers):
        sheets = marker_sheets(kind, kind.ids or (0,), options.page)
    else:
        sheets = board_sheets(kind, options.page)
    keep_copy(options.out)
    with atomic_file(options.out) as temporary:
        write_pdf(temporary, sheets)
    write_target(described, kind)
    terminal.note(f"{options.out}: {len(sheets)} page{'s' * (len(sheets) > 1)}; print at 100 % and measure the ruler")
    terminal.note(f"{described}: the target's description, which the other steps take as --target {described}")
    step = "extrinsics" if isinstance(kind, Markers) else "intrinsics"
    terminal.next(
        "posefuse record --source cam1=usb:/dev/video0 ... --out SESSION", f"videos of it for `posefuse calibrate {step}`"
    )
    return {"pdf": str(options.out), "pages": len(sheets), "target": str(described)}


def _described(options: PrintOptions) -> Target:
    """The target that options describe; raises InputError naming those that are missing."""
    kind = {"kind": "markers"} if options.cube else {"kind": "charuco", **options.changes}
    said = TargetDescription(**{**options.changes, **kind})
    return described_target(said, lambda names: InputError(f"--target {said.kind}: missing {', '.join(map(option_name, names))}"))
