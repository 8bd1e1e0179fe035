"""`posefuse calibrate`: lenses, places, verification, and targets to print."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

from .options import add_networks, count, positive

SUMMARY = "calibrate cameras from recordings of a board, a marker prop or a person; find their clocks; verify; print targets"
# the largest values that can be meant: a target of 10 m, a day, ten times the fastest camera of a laboratory
MOST_MM, MOST_S, MOST_HZ, MOST_HEIGHT_M = 10_000.0, 86_400.0, 10_000.0, 3.0
# squares of a board along one side, and frames between two that are looked at
MOST_SQUARES, MOST_FRAMES = 200, 1_000_000
CLOCKS = ("auto", "together", "offset", "drift")
TARGETS = ("markers", "charuco", "chessboard", "aruco-board")


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
    two.add_argument("--clocks", choices=CLOCKS, default="auto",
                     help="estimate the cameras' clocks: never (together), always, or when needed (auto)")  # fmt: skip
    two.add_argument("--floor-marker", type=int, metavar="ID", help="marker of the same recordings that lies on the floor")
    two.add_argument("--floor-side-mm", type=positive(MOST_MM), metavar="MM", help="side of that marker, when it differs")
    two.add_argument("--floor-points", type=Path, metavar="FILE.toml",
                     help="or: pixels per camera of three points of the floor: origin, one along x, one towards y")  # fmt: skip
    two.add_argument("--refine-lenses", type=positive(100), metavar="PERCENT",
                     help="let the lenses move too; how well their focal lengths are known, e.g. 0.5")  # fmt: skip
    two.add_argument("--any-size", action="store_true", help="accept a rig far smaller or larger than a room")
    two.add_argument("--keep-refused", action="store_true",
                     help="write a refused result too, marked as refused; `posefuse track` then warns each time")  # fmt: skip
    two.add_argument("--upside-down", action="append", default=[], metavar="CAMERA", help="a camera that really hangs so")
    live = steps.add_parser("guide", help="at the cameras: what the waving has covered, and when it is enough")
    _add_target(live, "markers")
    live.add_argument("--intrinsics", type=Path, required=True, metavar="FILE", help="rig file with the cameras' names")
    live.add_argument("--source", action="append", required=True, metavar="CAMERA=KIND:WHERE", help="as in `posefuse live`")
    live.add_argument("--duration", type=positive(MOST_S), metavar="S", help="stop after so many seconds at the latest")
    live.add_argument("--view", action="store_true", help="show it in the Rerun viewer")
    live.add_argument("--view-file", type=Path, metavar="FILE.rrd", help="write what the viewer would show to a file")
    person = steps.add_parser("person", help="places of the cameras from a person who walks in front of them")
    person.add_argument("inputs", nargs="+", metavar="NAME=PATH", help="video, or 2D poses of another tool, per camera")
    person.add_argument("--intrinsics", type=Path, required=True, metavar="FILE", help="rig file with the lenses")
    person.add_argument(
        "--height-m", type=positive(MOST_HEIGHT_M), help="stature of the person, which sets the scale to a few per cent"
    )
    person.add_argument("--apart", nargs=3, metavar=("CAMERA", "CAMERA", "METRES"), help="or: measured distance of two cameras")
    person.add_argument("--rate-hz", type=positive(MOST_HZ), help="frame rate of 2D poses")
    person.add_argument(
        "--instants", type=count(MOST_FRAMES), default=600, metavar="N", help="instants of the videos to look at, at most"
    )
    person.add_argument("--clocks", choices=CLOCKS, default="auto",
                        help="estimate the cameras' clocks: never (together), always, or when needed (auto)")  # fmt: skip
    _add_most_s(person)
    person.add_argument("--upside-down", action="append", default=[], metavar="CAMERA", help="a camera that really hangs so")
    person.add_argument("--out", type=Path, required=True, metavar="FILE", help="rig file to write")
    add_networks(person)
    person.set_defaults(overrides=[])
    clocks = steps.add_parser("clocks", help="how far apart the clocks of calibrated cameras are, from a person who moves")
    clocks.add_argument("session", type=Path, metavar="SESSION", help="as for `posefuse track`: calibration and recordings")
    clocks.add_argument("--rig", type=Path, metavar="FILE", help="calibration file, when it is not in SESSION")
    clocks.add_argument("--input", choices=("auto", "videos", "images", "pose2d"), help="which data of the session to use")
    clocks.add_argument("--clocks", choices=("offset", "drift"), default="offset",
                        help="whether clocks run at rates of their own as well")  # fmt: skip
    clocks.add_argument("--rate-hz", type=positive(MOST_HZ), help="frame rate of 2D poses and images that state none")
    clocks.add_argument(
        "--seconds", type=positive(MOST_S), default=60.0, metavar="S", help="look at so much of the recording, its middle"
    )
    _add_most_s(clocks)
    add_networks(clocks)
    clocks.set_defaults(overrides=[])
    check = steps.add_parser("verify", help="millimetres and pixels of a rig, with a marker or board held anywhere")
    _add_target(check, "charuco")
    _add_inputs(check)
    check.add_argument("--rig", type=Path, required=True, metavar="FILE", help="rig file to verify")
    check.add_argument("--offset-ms", action="append", default=[], metavar="CAMERA=MS", help="a clock found by `extrinsics`")
    sheets = steps.add_parser("print", help="PDF of a target at its true size")
    sheets.add_argument("--cube", action="store_true", help="six markers for a cube")
    _add_target(sheets, "charuco")
    sheets.add_argument("--page", default="a4", help="a4, a3, a2, a1, a0 or letter")
    sheets.add_argument("--out", type=Path, required=True, metavar="FILE", help="PDF to write")
    for step in (one, two, live, person, clocks, check, sheets):
        # before the step it is understood as well
        step.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="figures as JSON on stdout")
        step.add_argument("--force", action="store_true", help="replace files; the old ones stay beside, as NAME.replaced-TIME")
    for step in (one, two, person, clocks, check):
        step.add_argument("--report", type=Path, metavar="FILE", help="HTML report, written also when the result is refused")


def _add_most_s(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--most-s", type=positive(MOST_S), default=10.0, metavar="S", help="how far clocks may be apart (default 10)"
    )


def _add_target(parser: argparse.ArgumentParser, default: str) -> None:
    group = parser.add_argument_group("target")
    group.add_argument("--target", choices=TARGETS, default=default)
    group.add_argument(
        "--columns", type=count(MOST_SQUARES), help="squares across (charuco), inner corners (chessboard), markers (aruco-board)"
    )
    group.add_argument("--rows", type=count(MOST_SQUARES), help="the same, down")
    group.add_argument("--square-mm", type=positive(MOST_MM), help="edge of a square")
    group.add_argument("--marker-mm", type=positive(MOST_MM), help="edge of a marker's black square")
    group.add_argument("--gap-mm", type=positive(MOST_MM), help="white between two markers (aruco-board)")
    group.add_argument("--dictionary", default="DICT_4X4_50", help="OpenCV's name of the marker dictionary")
    group.add_argument("--ids", type=int, nargs="*", default=[], help="markers of the prop (markers); default all")
    group.add_argument("--inverted", action="store_true", help="colours exchanged")
    group.add_argument("--legacy", action="store_true", help="ChArUco layout of OpenCV before 4.6")


def _add_inputs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "inputs", nargs="+", metavar="NAME=PATH", help="video or folder of images per camera; NAME defaults to the file's"
    )
    parser.add_argument("--every", type=count(MOST_FRAMES), default=1, metavar="N", help="look at every Nth frame")


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Do the step; a refused result is an error, after its report is written."""
    from posefuse.cli.calibrating.results import check_outputs

    check_outputs(args)
    return {"step": args.step, **_STEPS[args.step](args, terminal)}


def _prop(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    from posefuse.cli.calibrating import prop

    steps = {"intrinsics": prop.intrinsics, "extrinsics": prop.extrinsics, "verify": prop.verify_rig, "print": prop.print_target}
    return steps[args.step](args, terminal)


def _guide(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    from posefuse.cli.calibrating.guiding import guide_at_cameras

    return guide_at_cameras(args, terminal)


def _person(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    from posefuse.cli.calibrating.person import person

    return person(args, terminal)


def _clocks(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    from posefuse.cli.calibrating.clocks import clocks

    return clocks(args, terminal)


_STEPS = {
    "intrinsics": _prop,
    "extrinsics": _prop,
    "guide": _guide,
    "person": _person,
    "clocks": _clocks,
    "verify": _prop,
    "print": _prop,
}
