"""What the user wrote on the command line of `posefuse calibrate`, as targets, sources and clocks."""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posefuse.calibration.targets.corners import Observations
from posefuse.calibration.targets.detection import why_nothing
from posefuse.calibration.targets.kinds import ArucoBoard, Charuco, Chessboard, Markers, Target
from posefuse.core import CalibrationError, InputError, Rig, Source
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.sources import VIDEO_SUFFIXES, ImagesConfig, VideoConfig


def target_from_arguments(args: argparse.Namespace) -> Target:
    """The target described; raises InputError naming the sizes that are missing."""

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
        return Charuco(
            columns=columns,
            rows=rows,
            square_m=square,
            marker_m=marker,
            dictionary=args.dictionary,
            inverted=args.inverted,
            legacy=args.legacy,
        )
    if args.target == "chessboard":
        columns, rows, square = need("columns", "rows", "square_mm")
        return Chessboard(columns, rows, square)
    columns, rows, side, gap = need("columns", "rows", "marker_mm", "gap_mm")
    return ArucoBoard(
        columns=columns,
        rows=rows,
        side_m=side,
        gap_m=gap,
        dictionary=args.dictionary,
        first_id=args.ids[0] if args.ids else 0,
        inverted=args.inverted,
    )


def sources_from_arguments(inputs: list[str]) -> list[Source]:
    """Videos and folders of images, open; raises InputError for what is not there or is neither."""
    sources: list[Source] = []
    for text in inputs:
        name, path = name_and_path(text)
        if not path.exists():
            raise InputError(f"{path}: no such video or folder of images")
        if path.is_dir():
            sources.append(ImagesConfig(path, name).build())
        elif path.suffix.lower() in VIDEO_SUFFIXES:
            sources.append(VideoConfig(path, name).build())
        else:
            raise InputError(f"{path}: expected a folder of images or a video ({choices(VIDEO_SUFFIXES)})")
    return sources


def name_and_path(text: str) -> tuple[str, Path]:
    """``NAME=PATH``; the name defaults to the file's."""
    name, equals, path = text.partition("=")
    return (name, Path(path)) if equals else (Path(text).stem, Path(text))


def late_s(offsets: list[str], rig: Rig) -> Array:
    """(C,) clocks in s from texts ``CAMERA=MS``; 0 for cameras not named."""
    late_s = np.zeros(len(rig))
    for text in offsets:
        name, _, value = text.partition("=")
        try:
            late_s[rig.names.index(rig[name].name)] = float(value) / 1e3
        except ValueError:
            raise InputError(f"--offset-ms {text}: expected CAMERA=MILLISECONDS") from None
    return late_s


def seen_or_why_not(observations: Observations, source: Source, target: Target) -> Observations:
    """The observations, unless there are none: then say why."""
    if len(observations):
        return observations
    frames = [cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY) for frame in itertools.islice(source.frames(), 12)]
    raise CalibrationError(
        f"camera {source.camera}: the target is in none of {observations.frame_count[0]} frames: {why_nothing(frames, target)}"
    )
