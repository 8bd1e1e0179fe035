"""Calibration: intrinsics, extrinsics, clock offsets, and how good they are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from posefuse import core
from posefuse.calibration import intrinsics as board
from posefuse.calibration import verify as verification
from posefuse.calibration.clocks.sync import clocks_from_person
from posefuse.calibration.extrinsics import target as moving_target
from posefuse.calibration.extrinsics.own_intrinsics import cameras_of, start_sigma
from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.extrinsics.world import (
    check_floor,
    lens_sigma,
    moved_target,
    with_floor,
    world_rule,
)
from posefuse.calibration.person.scale import KnownLength
from posefuse.calibration.report import RefusedCalibration, after
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.detection import detect_corners
from posefuse.calibration.targets.kinds import Target, check_one_end, read_target
from posefuse.calibration.targets.recordings import (
    Inputs,
    observe_sources,
    open_sources,
    paths_by_camera,
    require_target_seen,
    seen_or_why_not,
)
from posefuse.core import SE3, InputError, Progress
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.formats.rig import rescaled_cameras
from posefuse.health.background import background_of
from posefuse.pipeline.calibration import (
    background_of_person,
    check_recordings,
    find_person,
    person_in_session,
    solve_person,
)
from posefuse.pipeline.config import CONFIG_FILE, read_config

from .arguments import checked, shown
from .calibration_results import ClockCalibration, IntrinsicsCalibration, RigCalibration, RigVerification, saved_clocks
from .rig_and_detector import rig_of
from .track import session_config

ClockMode = Literal["auto", "together", "offset", "drift"]
RigLike = core.Rig | str | Path
TargetLike = Target | str | Path
"""A target, or the target file that `posefuse calibrate print` wrote."""
Settings = Mapping[str, Any]


@checked
def observe_target(
    inputs: Inputs, *, target: TargetLike, every: int = 1, progress: Progress | bool | None = None
) -> CornerObservations:
    """Find a target in the recordings of several cameras, for `calibrate_extrinsics` and `verify`.

    Args:
        inputs: videos or folders of images: a mapping by camera name, paths whose stems are the cameras' names, or texts
            ``NAME=PATH``; or one session folder with ``videos``.
        target: what the cameras see, or the path of its target file. every: look at every `every`-th frame only.
        progress: True for bars on stderr, or a function (see `Progress`).

    Raises:
        InputError: a path that does not exist, or is neither a video nor a folder of images.
        CalibrationError: a chessboard, whose corners cameras count from different ends.
    """
    check_one_end(kind := target_of(target))
    with shown(progress) as report:
        return _observed(inputs, None, kind, every, report)


@checked
def calibrate_intrinsics(
    inputs: Inputs, *, target: TargetLike, every: int = 1, progress: Progress | bool | None = None
) -> IntrinsicsCalibration:
    """Find focal lengths, principal point and distortion of each camera from images of a board.

    Args:
        inputs: videos or folders of images: a mapping by camera name, or paths whose stems are the cameras' names.
        target: what the cameras see: a board, or an object with markers.
        every: use every `every`-th frame only.
        progress: True for bars on stderr, or a function (see `Progress`).

    Returns:
        The cameras (all at the origin), and a report per camera.

    Raises:
        RefusedCalibration: a check of a camera fails, or the target was not found in it; `report` names it and the next step,
            notes name further cameras, and `kept` has the `IntrinsicsCalibration` of the others.
        InputError: unusable recordings.

    Examples:
        >>> import posefuse as pf
        >>> from posefuse.calibration.targets.kinds import Charuco
        >>> board = Charuco(columns=5, rows=7, square_m=0.04, marker_m=0.03)
        >>> found = pf.calibrate_intrinsics(["cam00.mp4", "cam01.mp4"], target=board)  # doctest: +SKIP
        >>> found.save("lenses.toml", report="lenses.html")  # doctest: +SKIP
    """
    found, refused, kind = [], [], target_of(target)
    board.check_board(kind)
    with shown(progress) as report:
        sources = open_sources(inputs)
        for done, source in enumerate(sources):
            report("intrinsics", done, len(sources))
            try:
                observations = seen_or_why_not(detect_corners(source, kind, every), source, kind)
                found.append(board.calibrate_intrinsics(observations, kind))
            except RefusedCalibration as error:
                refused.append(error)
        report("intrinsics", len(sources), len(sources))
    others = None if not found else _intrinsics(found)
    if refused:
        first, *more = refused
        for one in more:
            first.add_note(str(one))
        first.kept = others
        raise first
    assert others is not None
    return others


def _intrinsics(found: Sequence[board.Intrinsics]) -> IntrinsicsCalibration:
    return IntrinsicsCalibration(
        rig=rig_of(core.Rig(tuple(one.camera for one in found), world_set_by="lenses only")),
        reports={one.camera.name: one.report for one in found},
        cells={one.camera.name: one.cells for one in found},
    )


@checked
def calibrate_extrinsics(
    inputs: Inputs | CornerObservations,
    *,
    intrinsics: RigLike | None = None,
    target: TargetLike,
    every: int = 1,
    clocks: ClockMode = "auto",
    floor_marker: int | None = None,
    focal_known_to_percent: float | None = None,
    upside_down: Sequence[str] = (),
    any_size: bool = False,
    keep_refused: bool = False,
    progress: Progress | bool | None = None,
) -> RigCalibration:
    """Find the poses of the cameras from a target that is moved in front of them.

    Args:
        inputs: recordings as in `calibrate_intrinsics`, or observations that `observe_target` returned.
        intrinsics: a rig whose cameras have these names; its poses are not used.
        target: what the cameras see: a board, or an object with markers.
        every: use every `every`-th frame only.
        progress: True for bars on stderr, or a function (see `Progress`).
        clocks: ``together``: the cameras are synchronised; ``offset`` or ``drift``: estimate each camera's clock; ``auto``:
            when they turn out not to be synchronised.
        floor_marker: id of a marker that lies on the floor, face up, in the same recordings, of the dictionary and size of the
            target's: it sets the world coordinates. None: up is estimated from the cameras.
        focal_known_to_percent: refine the intrinsics too; this is how well the focal lengths are known. None keeps them.
        upside_down: cameras that are mounted upside down.
        any_size: also accept a rig that is far smaller or larger than a room.
        keep_refused: return a refused calibration too. Its rig is marked as refused, and `report.failed` states why.

    Raises:
        RefusedCalibration: a check fails; `report` names it and the next step.
        CalibrationError: input that cannot be used.
        InputError: unusable recordings.

    Examples:
        >>> import posefuse as pf
        >>> videos = {"cam00": "cam00.mp4", "cam01": "cam01.mp4"}
        >>> found = pf.calibrate_extrinsics(videos, intrinsics="lenses.toml", target="cube.toml")  # doctest: +SKIP
        >>> found.save("rig.toml", report="rig.html")  # doctest: +SKIP
    """
    lenses, kind = None if intrinsics is None else rig_of(intrinsics), target_of(target)
    if lenses is None and focal_known_to_percent is not None:
        raise InputError("`focal_known_to_percent=P`: needs `intrinsics=FILE` to refine; without them, all are estimated")
    check_one_end(kind)
    check_floor(floor_marker, kind)
    _check_names(upside_down, inputs.cameras if isinstance(inputs, CornerObservations) else paths_by_camera(inputs))
    seen = inputs
    if not isinstance(seen, CornerObservations):
        with shown(progress) as report:
            seen = _observed(seen, lenses, with_floor(kind, floor_marker), every, report)
    observations, world = world_rule(floor_marker, seen, kind)
    sources = open_sources(dict(seen.recordings))
    require_target_seen(observations, sources, moved_target(kind, floor_marker))
    options = Options(clocks=clocks, any_size=any_size, own_intrinsics=lenses is None)
    rescaled: tuple[str, ...] = ()
    if lenses is None:
        cameras = cameras_of(observations, kind, options)
    else:
        cameras, rescaled = rescaled_cameras([lenses[name] for name in seen.cameras], _sizes_wh(seen))
    sigma = start_sigma(cameras) if lenses is None else lens_sigma(focal_known_to_percent, cameras)
    options = replace(options, lens_sigma=sigma)
    try:
        found = after(
            background_of(sources, cameras).report,
            lambda: moving_target.calibrate_extrinsics(observations, cameras, kind, options, world, tuple(upside_down)),
        )
    except RefusedCalibration as refused:
        if not keep_refused or refused.kept is None:
            for note in rescaled:
                refused.add_note(note)
            raise
        names = ", ".join(check.name for check in refused.report.failed)
        found = replace(refused.kept, report=refused.report, rig=replace(refused.kept.rig, refused=names))
    return RigCalibration(
        rig=rig_of(found.rig),
        report=replace(found.report, notes=(*rescaled, *found.report.notes)),
        clocks=found.clocks if found.clocks.offset_s.any() or found.clocks.drift.any() else None,
        cells={camera.name: found.coverage.cells[i] for i, camera in enumerate(found.rig)},
        position_cov_m2={camera.name: found.position_cov_m2[i] for i, camera in enumerate(found.rig)},
    )


def _observed(inputs: Inputs, lenses: core.Rig | None, target: Target, every: int, report: Progress) -> CornerObservations:
    sources = open_sources(inputs)
    if lenses is not None:
        for source in sources:
            lenses[source.camera]
    seen = observe_sources(sources, target, every, report)
    return replace(seen, recordings=tuple(paths_by_camera(inputs).items()))


@checked
def calibrate_person(
    inputs: Inputs,
    *,
    intrinsics: RigLike,
    height_m: float | None = None,
    camera_distance: tuple[str, str, float] | None = None,
    rate_hz: float | None = None,
    clocks: ClockMode = "auto",
    max_offset_s: float = 10.0,
    upside_down: Sequence[str] = (),
    settings: Settings | None = None,
    progress: Progress | bool | None = None,
) -> RigCalibration:
    """Find the poses of the cameras from a person who walks in front of them.

    Args:
        inputs: per camera a video, of which the middle 60 s are used, or 2D poses of another tool; by camera name, or paths.
        intrinsics: a rig whose cameras have these names; its poses are not used.
        height_m: height of the person in metres, which sets the scale within a few per cent.
        camera_distance: or two cameras and their measured distance in metres.
        rate_hz: frame rate of 2D poses.
        clocks: as in `calibrate_extrinsics`.
        max_offset_s: largest clock offset between two cameras to search for.
        upside_down: cameras that are mounted upside down.
        settings: other settings of `track` by dotted key, e.g. ``{"detector.options.landmarks": "blazepose_best"}``.
        progress: True for bars on stderr, or a function (see `Progress`).

    Raises:
        RefusedCalibration: a check fails; `report` names it and the next step.
        CalibrationError: cameras that cannot be linked by what they see.
        InputError: unusable recordings, or not one length.

    Examples:
        >>> import posefuse as pf
        >>> videos = {"cam00": "cam00.mp4", "cam01": "cam01.mp4"}
        >>> found = pf.calibrate_person(videos, intrinsics="lenses.toml", height_m=1.80)  # doctest: +SKIP
        >>> found.save("rig.toml", report="rig.html")  # doctest: +SKIP
    """
    paths, lenses = paths_by_camera(inputs), rig_of(intrinsics)
    check_recordings(paths)
    _check_names(upside_down, paths)
    chosen = core.Rig(tuple(lenses[name] for name in paths))
    length = _known_length(height_m, camera_distance, chosen)
    cameras = tuple(replace(camera, cam_from_world=SE3.identity()) for camera in chosen)
    config = read_config(None, settings or {})

    def solve(report: Progress) -> RigCalibration:
        seen = find_person(
            paths, cameras, length, detector=config.detector, rate_hz=rate_hz, clocks=clocks, most_s=max_offset_s, progress=report
        )
        found, estimate = solve_person(seen, length, with_drift=clocks == "drift", upside_down=upside_down)
        # the intrinsics as they were given: videos of another size are fitted again wherever they are read
        poses = {camera.name: camera.cam_from_world for camera in found.rig}
        placed = replace(found.rig, cameras=tuple(replace(camera, cam_from_world=poses[camera.name]) for camera in cameras))
        return RigCalibration(rig=rig_of(placed), report=found.report, clocks=estimate)

    with shown(progress) as report:
        return after(background_of_person(paths, cameras), lambda: solve(report))


@checked
def calibrate_clocks(
    session: str | Path,
    *,
    rig: str | Path | None = None,
    drift: bool = False,
    rate_hz: float | None = None,
    seconds: float = 60.0,
    max_offset_s: float = 10.0,
    settings: Settings | None = None,
    progress: Progress | bool | None = None,
) -> ClockCalibration:
    """Find the clock offsets of calibrated cameras that are not synchronised, from a person who moves.

    Args:
        session: as in `track`.
        rig: another calibration file.
        drift: estimate different clock rates, too.
        rate_hz: of 2D poses in files, and of images without times.
        seconds: length of the part in the middle of the recording that is used.
        max_offset_s: largest offset between two cameras.
        settings: other settings of `track` by dotted key.
        progress: True for bars on stderr, or a function (see `Progress`).

    Raises:
        RefusedCalibration: a check fails; `report` names it and the next step.
        InputError: no session, or no frame rate.

    Examples:
        >>> import posefuse as pf
        >>> found = pf.calibrate_clocks("SESSION")  # doctest: +SKIP
        >>> found.clocks.offset_s  # seconds that each camera's times are late  # doctest: +SKIP
    """
    given = {"rig": rig, "rate_hz": rate_hz}
    changes = {key: value for key, value in given.items() if value is not None} | dict(settings or {})
    config = session_config(folder := Path(session), None, changes)
    with shown(progress) as report:
        seen = person_in_session(folder, config, seconds, report)
        found = after(seen.background, lambda: clocks_from_person(seen.rig, seen.tracks, max_offset_s, drift))
    return ClockCalibration(rig=rig_of(seen.rig), clocks=found.clocks, report=found.report)


@checked
def verify(
    rig: RigLike,
    inputs: Inputs | CornerObservations,
    *,
    target: TargetLike,
    every: int = 1,
    progress: Progress | bool | None = None,
) -> RigVerification:
    """Measure the errors of a rig with a target that was not used for its calibration, held anywhere.

    Args:
        rig: the rig to verify; of a rig file, with the clock offsets of the ``posefuse.toml`` next to it.
        inputs: videos or folders of images: a mapping by camera name, or paths whose stems are the cameras' names.
        target: what the cameras see: a board, or an object with markers.
        every: use every `every`-th frame only.
        progress: True for bars on stderr, or a function (see `Progress`).

    Returns:
        The errors and the checks, also where a check fails: see `RigVerification.passed`.

    Raises:
        CalibrationError: a camera the rig does not have, or no length that two cameras see.
        InputError: unusable recordings, or clocks that drift next to the rig file.

    Examples:
        >>> import posefuse as pf
        >>> found = pf.verify("rig.toml", {"cam00": "cam00.mp4", "cam01": "cam01.mp4"}, target="cube.toml")  # doctest: +SKIP
        >>> found.passed, found.report  # doctest: +SKIP
    """
    cameras, kind = rig_of(rig, placed=True), target_of(target)
    settings = None if isinstance(rig, core.Rig) else Path(rig).with_name(CONFIG_FILE)
    offsets = {} if settings is None else saved_clocks(settings, cameras)
    notes = (f"clock offsets of {', '.join(offsets)} from {settings}",) if offsets else ()
    late_s: Array = np.array([offsets.get(name, 0.0) for name in cameras.names])
    seen = (
        inputs if isinstance(inputs, CornerObservations) else observe_target(inputs, target=kind, every=every, progress=progress)
    )
    fitted, rescaled = rescaled_cameras(cameras.cameras, _sizes_wh(seen))
    measured = verification.verify(replace(cameras, cameras=fitted), seen, kind, late_s)
    return RigVerification(rig=cameras, report=replace(measured.report, notes=(*notes, *rescaled)), measured=measured)


def _check_names(upside_down: Sequence[str], cameras: Iterable[str]) -> None:
    known = tuple(cameras)
    if unknown := [name for name in upside_down if name not in known]:
        raise InputError(f"`upside_down={unknown[0]}`: no such camera; there are: {choices(known)}")


def _sizes_wh(seen: CornerObservations) -> dict[str, tuple[int, int]]:
    return dict(zip(seen.cameras, seen.sizes_wh, strict=True))


def target_of(target: TargetLike) -> Target:
    """The target itself; raises ConfigError for a target file that cannot be used."""
    return read_target(Path(target)) if isinstance(target, str | Path) else target


def _known_length(height_m: float | None, camera_distance: tuple[str, str, float] | None, rig: core.Rig) -> KnownLength:
    if (height_m is None) == (camera_distance is None):
        raise InputError("person: the scale needs one known length: `height_m=METRES`, or `camera_distance=CAMERA CAMERA METRES`")
    if camera_distance is None:
        return KnownLength(stature_m=height_m)
    first, second, metres = camera_distance
    return KnownLength(apart=(rig[first].name, rig[second].name, metres))
