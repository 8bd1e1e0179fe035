"""The step for cameras that are calibrated but not synchronised: how far apart their clocks are, from a person who moves."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from posefuse.calibration.clocks.person import clocks_from_person
from posefuse.calibration.clocks.person_tracks import PersonTrack, person_tracks
from posefuse.cli.networks import fetch_networks
from posefuse.cli.terminal import Terminal
from posefuse.core import InputError, Rig
from posefuse.detection.build import build_detector
from posefuse.formats.pose2d import read_pose2d
from posefuse.pipeline.config import CONFIG_FILE, TrackConfig, read_config
from posefuse.pipeline.images import common_timeline
from posefuse.pipeline.opening import build_source
from posefuse.pipeline.pose2d import stated_camera
from posefuse.pipeline.pose2d_rate import pose2d_rate_hz
from posefuse.pipeline.session import Session, find_session, fitted_camera

from .person_poses import poses_apart
from .results import frame_period_s, reported, show, show_clocks, write_clocks, write_report

# neighbouring frames err alike: more of them tell little more
_MOST_HZ = 15.0
# the rig as it applies to the images, the person in each camera, and seconds between its frames
_Seen = tuple[Rig, tuple[PersonTrack, ...], list[float]]


def clocks(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Offset of every camera of a session, written as settings that `posefuse track` of it reads."""
    path = args.session / CONFIG_FILE
    config = read_config(path if path.is_file() else None, args.overrides)
    if args.rig is not None:
        config = replace(config, rig=str(args.rig.absolute()))
    if args.input is not None:
        config = replace(config, input=args.input)
    session = find_session(args.session, config)
    config = replace(config, rate_hz=args.rate_hz or config.rate_hz)
    kinds = {entry.kind for entry in session.inputs}
    if len(kinds) > 1:
        raise InputError(f"{session.folder}: expected one kind of data for all cameras, got {', '.join(sorted(kinds))}")
    if kinds == {"pose2d"}:
        rig, tracks, period_s = _from_files(session, config, args.seconds)
    else:
        rig, tracks, period_s = _from_images(session, config, args.seconds, terminal)
    with reported(args):
        found = clocks_from_person(rig, tracks, args.most_s, args.clocks == "drift")
    show(found.report, terminal)
    show_clocks(rig.names, found.clocks, period_s, terminal)
    write_report(args.report, found.report, {}, rig)
    settings = write_clocks(path, rig.names, found.clocks, terminal)
    terminal.next(
        f"posefuse track {args.session} --out RESULT", "uses the clocks found" if settings else "the clocks need no correction"
    )
    return {"settings": settings and str(settings), **found.report.numbers}


def _from_images(session: Session, config: TrackConfig, seconds: float, terminal: Terminal) -> _Seen:
    """The person in videos or image folders, at the stamps that these have by themselves."""
    as_recorded = [replace(entry, settings=replace(entry.settings, offset_s=0.0, drift_ppm=0.0)) for entry in session.inputs]
    sources = [build_source(entry, config) for entry in as_recorded]
    cameras = [fitted_camera(session.rig[one.camera], entry, one) for entry, one in zip(as_recorded, sources, strict=True)]
    rig = replace(session.rig, cameras=tuple(cameras))
    times_ns = {source.camera: np.asarray(source.times_ns()) for source in sources}
    period_s = [frame_period_s(t) for t in times_ns.values()]
    first_s, last_s = (float(np.median([t[i] for t in times_ns.values()])) / 1e9 for i in (0, -1))
    spare_s = max(0.0, (last_s - first_s - seconds) / 2)
    cut = (first_s + spare_s, last_s - spare_s) if spare_s else (None, None)
    timeline = common_timeline(times_ns, min(1 / min(period_s), _MOST_HZ), *cut)
    fetch_networks(config.detector, terminal)
    detector = build_detector(config.detector, rig)
    with terminal.progress("finding the person") as advance:
        return rig, person_tracks(poses_apart(sources, detector, timeline, advance)), period_s


def _from_files(session: Session, config: TrackConfig, seconds: float) -> _Seen:
    poses = [read_pose2d(entry.path, entry.camera, size_wh=session.rig[entry.camera].size_wh) for entry in session.inputs]
    rate_hz = pose2d_rate_hz(session, poses, config)
    found = {}
    for entry, one in zip(session.inputs, poses, strict=True):
        frames = list(one.frames(rate_hz))
        spare = max(0, len(frames) - round(seconds * rate_hz)) // 2
        found[entry.camera] = frames[spare : len(frames) - spare]
    cameras = tuple(stated_camera(session.rig[entry.camera], entry) for entry in session.inputs)
    return replace(session.rig, cameras=cameras), person_tracks(found), [1 / rate_hz] * len(cameras)
