"""The step without any target: places of the cameras from a person who walks in front of them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from posefuse.calibration.clocks.person import numbers
from posefuse.calibration.clocks.person_tracks import PersonTrack, person_tracks
from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.person.settle import calibrate_out_of_step, unplaced_clocks
from posefuse.calibration.person.solve import KnownLength, PersonCalibration, calibrate_from_person
from posefuse.calibration.person.views import PersonViews, person_views
from posefuse.cli.terminal import Terminal
from posefuse.core import SE3, Camera, InputError, Rig
from posefuse.core.errors import choices
from posefuse.formats.pose2d import read_pose2d
from posefuse.formats.rig import read_rig
from posefuse.pipeline.config import CONFIG_FILE, read_config
from posefuse.pipeline.session import LEAST_CAMERAS
from posefuse.sources import VIDEO_SUFFIXES, VideoConfig

from .inputs import name_and_path
from .person_poses import person_in_videos
from .results import frame_period_s, reported, show, show_clocks, write_clocks, write_report, write_rig_file


def person(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Rig file and report from videos, or from 2D poses that another tool has written."""
    lenses, paths = read_rig(args.intrinsics), _paths(args)
    length = _known_length(args, Rig(tuple(lenses[name] for name in paths)))
    cameras = tuple(replace(lenses[name], cam_from_world=SE3.identity()) for name in paths)
    with reported(args):
        seen = _seen(args, paths, cameras, length, terminal)
        found, clocks = _solved(args, seen, length)
    show(found.report, terminal)
    # the lenses as they were given: videos of another size are fitted anew wherever they are read
    placed = {camera.name: camera.cam_from_world for camera in found.rig}
    rig = replace(found.rig, cameras=tuple(replace(camera, cam_from_world=placed[camera.name]) for camera in cameras))
    write_rig_file(args.out, rig)
    write_report(args.report, found.report, {}, rig)
    terminal.next(f"put {args.out} beside your videos and run: posefuse track SESSION --out RESULT", "the 3D skeleton")
    if clocks is None:
        return {"rig": str(args.out), "settings": None, **found.report.numbers}
    show_clocks(rig.names, clocks, _periods_s(args, paths), terminal)
    settings = write_clocks(args.out.with_name(CONFIG_FILE), rig.names, clocks, terminal)
    return {"rig": str(args.out), "settings": settings and str(settings), **found.report.numbers, **numbers(rig.names, clocks)}


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the cameras saw of the person.

    Attributes:
        tracks: at the cameras' own moments. views: at common ones. seen_by: the cameras, as their images were.
        clocks: found first; None where the cameras are in step. applied: the tracks' stamps are put right by them already.
    """

    tracks: tuple[PersonTrack, ...]
    views: PersonViews
    seen_by: tuple[Camera, ...]
    clocks: ClockEstimate | None
    applied: bool


def _paths(args: argparse.Namespace) -> dict[str, Path]:
    """What each camera recorded."""
    paths = dict(name_and_path(text) for text in args.inputs)
    if len(paths) < LEAST_CAMERAS:
        raise InputError(f"person: expected at least {LEAST_CAMERAS} cameras, got {len(paths)}")
    if not args.most_s > 0:
        raise InputError(f"--most-s: expected > 0, got {args.most_s:g}")
    absent = [str(path) for path in paths.values() if not path.exists()]
    if absent:
        raise InputError(f"person: no such file or folder: {choices(absent)}")
    return paths


def _seen(
    args: argparse.Namespace, paths: dict[str, Path], cameras: tuple[Camera, ...], length: KnownLength, terminal: Terminal
) -> _Seen:
    videos = [path for path in paths.values() if path.suffix.lower() in VIDEO_SUFFIXES]
    if len(videos) == len(paths):
        choice = read_config(None, args.overrides).detector
        views, seen_by, clocks = person_in_videos(
            paths, Rig(cameras), length, choice, args.instants, terminal, args.clocks, args.most_s
        )
        return _Seen(views.tracks(), views, seen_by, clocks, True)
    if videos:
        raise InputError(f"person: expected videos or 2D poses for all cameras, got both: {choices(map(str, paths.values()))}")
    tracks = _from_files(args, paths, cameras)
    return _Seen(tracks, person_views(tracks), cameras, unplaced_clocks(tracks, cameras, length, args.clocks, args.most_s), False)


def _solved(args: argparse.Namespace, seen: _Seen, length: KnownLength) -> tuple[PersonCalibration, ClockEstimate | None]:
    """The rig, and the clocks where the cameras are not in step."""
    upside_down, clocks = tuple(args.upside_down), seen.clocks
    if clocks is None:
        return calibrate_from_person(seen.views, seen.seen_by, length, upside_down), None
    start = ClockEstimate.known(np.zeros(len(seen.tracks)), clocks.middle_s) if seen.applied else clocks
    found, left = calibrate_out_of_step(seen.tracks, seen.seen_by, length, start, args.clocks == "drift", upside_down)
    return found, clocks.then(left) if seen.applied else left


def _known_length(args: argparse.Namespace, rig: Rig) -> KnownLength:
    if (args.height_m is None) == (args.apart is None):
        raise InputError("person: the scale needs one known length: --height-m METRES, or --apart CAMERA CAMERA METRES")
    if args.height_m is not None:
        return KnownLength(stature_m=args.height_m)
    first, second, metres = args.apart
    try:
        return KnownLength(cameras=(rig[first].name, rig[second].name), distance_m=float(metres))
    except ValueError:
        raise InputError(f"--apart {first} {second} {metres}: expected a number of metres at the end") from None


def _periods_s(args: argparse.Namespace, paths: Mapping[str, Path]) -> list[float]:
    """Seconds between two frames of each camera."""
    return [
        frame_period_s(VideoConfig(path, name).build().times_ns()) if path.suffix.lower() in VIDEO_SUFFIXES else 1 / args.rate_hz
        for name, path in paths.items()
    ]


def _from_files(args: argparse.Namespace, paths: Mapping[str, Path], cameras: tuple[Camera, ...]) -> tuple[PersonTrack, ...]:
    if args.rate_hz is None:
        raise InputError("person: 2D poses do not state their frame rate: add --rate-hz")
    poses = {camera.name: read_pose2d(paths[camera.name], camera.name, size_wh=camera.size_wh) for camera in cameras}
    return person_tracks({name: list(frames.frames(args.rate_hz)) for name, frames in poses.items()})
