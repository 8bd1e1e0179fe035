"""The step without any target: places of the cameras from a person who walks in front of them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from posefuse.app.config import read_config
from posefuse.app.session import LEAST_CAMERAS
from posefuse.app.terminal import Terminal
from posefuse.calibrate.person import KnownLength, calibrate_from_person
from posefuse.calibrate.person_tracks import person_tracks
from posefuse.calibrate.person_views import PersonViews, person_views
from posefuse.core import SE3, InputError, Rig
from posefuse.core.errors import choices
from posefuse.detect.openpose import read_openpose_folder
from posefuse.files.rig import read_rig, write_rig
from posefuse.sources import VIDEO_SUFFIXES

from .inputs import name_and_path
from .person_poses import person_in_videos
from .results import reported, show, write_report


def person(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Rig file and report from videos, or from 2D poses that another tool has written."""
    lenses, paths = read_rig(args.intrinsics), dict(name_and_path(text) for text in args.inputs)
    if len(paths) < LEAST_CAMERAS:
        raise InputError(f"person: expected at least {LEAST_CAMERAS} cameras, got {len(paths)}")
    absent = [str(path) for path in paths.values() if not path.exists()]
    if absent:
        raise InputError(f"person: no such file or folder: {choices(absent)}")
    length = _known_length(args, Rig(tuple(lenses[name] for name in paths)))
    cameras = tuple(replace(lenses[name], cam_from_world=SE3.identity()) for name in paths)
    videos = [path for path in paths.values() if path.suffix.lower() in VIDEO_SUFFIXES]
    with reported(args):
        if len(videos) == len(paths):
            choice = read_config(None, args.overrides).detector
            views, seen_by = person_in_videos(paths, Rig(cameras), length, choice, args.instants, terminal)
        elif videos:
            raise InputError(
                f"person: expected videos or folders of 2D poses for all cameras, got both: {choices(map(str, paths.values()))}"
            )
        else:
            views, seen_by = _from_files(args, paths), cameras
        found = calibrate_from_person(views, seen_by, length, tuple(args.upside_down))
    show(found.report, terminal)
    # the lenses as they were given: videos of another size are fitted anew wherever they are read
    placed = {camera.name: camera.cam_from_world for camera in found.rig}
    rig = replace(found.rig, cameras=tuple(replace(camera, cam_from_world=placed[camera.name]) for camera in cameras))
    write_rig(args.out, rig)
    write_report(args.report, found.report, {}, rig)
    return {"rig": str(args.out), **found.report.numbers}


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


def _from_files(args: argparse.Namespace, paths: Mapping[str, Path]) -> PersonViews:
    if args.rate_hz is None:
        raise InputError("person: folders of 2D poses do not say their frame rate: add --rate-hz")
    frames = {name: list(read_openpose_folder(path, name).frames(args.rate_hz)) for name, path in paths.items()}
    return person_views(person_tracks(frames))
