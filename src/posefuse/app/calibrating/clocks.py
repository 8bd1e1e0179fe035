"""The step for cameras that are calibrated but not synchronised: how far apart their clocks are, from a person who moves."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from posefuse.app.config import CONFIG_FILE, TrackConfig, read_config
from posefuse.app.detectors import build_detector
from posefuse.app.recorded.instants import common_timeline
from posefuse.app.recorded.pose2d import stated_camera
from posefuse.app.recorded.run import build_source
from posefuse.app.session import Session, find_session, fitted_camera
from posefuse.app.terminal import Terminal
from posefuse.calibrate.person_clocks import clocks_from_person
from posefuse.calibrate.person_tracks import PersonTrack, person_tracks
from posefuse.calibrate.sync import ClockEstimate
from posefuse.core import InputError, Rig
from posefuse.detect.openpose import read_openpose_folder

from .person_poses import poses_apart
from .results import reported, show, write_clocks, write_report

# neighbouring frames err alike: more of them tell little more
_MOST_HZ = 15.0


def clocks(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Offset of every camera of a session, written as settings that `posefuse track` of it reads."""
    for option, value in (("--most-s", args.most_s), ("--seconds", args.seconds), ("--rate-hz", args.rate_hz)):
        if value is not None and not value > 0:
            raise InputError(f"{option}: expected > 0, got {value:g}")
    path = args.session / CONFIG_FILE
    config = read_config(path if path.is_file() else None, args.overrides)
    if args.rig is not None:
        config = replace(config, rig=str(args.rig.absolute()))
    session = find_session(args.session, config)
    kinds = {entry.kind for entry in session.inputs}
    if len(kinds) > 1:
        raise InputError(f"{session.folder}: expected one kind of data for all cameras, got {', '.join(sorted(kinds))}")
    if kinds == {"pose2d"}:
        rig, tracks = _from_files(session, args.rate_hz or config.rate_hz, args.seconds)
    else:
        rig, tracks = _from_images(session, replace(config, rate_hz=args.rate_hz or config.rate_hz), args.seconds, terminal)
    with reported(args):
        found = clocks_from_person(rig, tracks, args.most_s, args.clocks == "drift")
    show(found.report, terminal)
    show_clocks(tracks, found.clocks, terminal)
    write_report(args.report, found.report, {}, rig)
    settings = write_clocks(path, rig.names, found.clocks, terminal)
    return {"settings": settings and str(settings), **found.report.numbers}


def show_clocks(tracks: Sequence[PersonTrack], clocks: ClockEstimate, terminal: Terminal) -> None:
    """A table of all cameras, in ms and in frames of their own."""
    rows: list[list[Any]] = []
    for c, track in enumerate(tracks):
        period_s = float(np.median(np.diff(track.t_ns))) / 1e9
        offset, sigma = clocks.offset_s[c], clocks.offset_sigma_s[c]
        rows.append([track.camera, _both(offset * 1e3, sigma * 1e3, 1), _both(offset / period_s, sigma / period_s, 2)])
        if clocks.drift_sigma.any():
            rows[-1].append(_both(clocks.drift[c] * 1e6, clocks.drift_sigma[c] * 1e6, 0))
    columns = ("camera", "stamps late by, ms", "in frames looked at", "drift, ppm")
    terminal.table(f"clocks, against {tracks[0].camera}", columns[: len(rows[0])], rows)


def _both(value: float, sigma: float, digits: int) -> str:
    return f"{value:+.{digits}f} ± {sigma:.{digits}f}"


def _from_images(
    session: Session, config: TrackConfig, seconds: float, terminal: Terminal
) -> tuple[Rig, tuple[PersonTrack, ...]]:
    """The person in videos or image folders, at the stamps that these have by themselves."""
    as_recorded = [replace(entry, settings=replace(entry.settings, offset_s=0.0, drift_ppm=0.0)) for entry in session.inputs]
    sources = [build_source(entry, config) for entry in as_recorded]
    cameras = [fitted_camera(session.rig[one.camera], entry, one) for entry, one in zip(as_recorded, sources, strict=True)]
    rig = replace(session.rig, cameras=tuple(cameras))
    times_ns = {source.camera: np.asarray(source.times_ns()) for source in sources}
    fastest_hz = max(1e9 / float(np.median(np.diff(t))) for t in times_ns.values() if len(t) > 1)
    first_s, last_s = (float(np.median([t[i] for t in times_ns.values()])) / 1e9 for i in (0, -1))
    spare_s = max(0.0, (last_s - first_s - seconds) / 2)
    cut = (first_s + spare_s, last_s - spare_s) if spare_s else (None, None)
    timeline = common_timeline(times_ns, min(fastest_hz, _MOST_HZ), *cut)
    detector = build_detector(config.detector, rig)
    with terminal.progress("finding the person") as advance:
        return rig, person_tracks(poses_apart(sources, detector, timeline, advance))


def _from_files(session: Session, rate_hz: float | None, seconds: float) -> tuple[Rig, tuple[PersonTrack, ...]]:
    if rate_hz is None:
        raise InputError(f"{session.folder}: folders of 2D poses do not say their frame rate: add --rate-hz")
    found = {}
    for entry in session.inputs:
        frames = list(read_openpose_folder(entry.path, entry.camera).frames(rate_hz))
        spare = max(0, len(frames) - round(seconds * rate_hz)) // 2
        found[entry.camera] = frames[spare : len(frames) - spare]
    cameras = tuple(stated_camera(session.rig[entry.camera], entry) for entry in session.inputs)
    return replace(session.rig, cameras=cameras), person_tracks(found)
