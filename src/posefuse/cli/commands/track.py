"""`posefuse track`: a session folder to a 3D result."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

from .options import add_networks

SUMMARY = "turn a session (calibration + videos, image folders or 2D poses) into a 3D skeleton and write its files"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The session, the result, and shortcuts for the most wanted settings."""
    parser.add_argument(
        "session",
        type=Path,
        metavar="SESSION",
        help="folder with calibration and recordings, or .mcap of `posefuse live`",
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for the result; must not exist, or use --force"
    )
    again = parser.add_mutually_exclusive_group()
    again.add_argument("--force", action="store_true", help="replace the results in DIR, and begin interrupted work anew")
    again.add_argument("--resume", action="store_true", help="continue where the same command was interrupted")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="TOML settings; default: SESSION/posefuse.toml if it is there"
    )
    parser.add_argument(
        "--set", dest="overrides", action="append", default=[], metavar="KEY=VALUE", help="any setting, e.g. fuse.weights=score"
    )
    add_networks(parser)
    parser.add_argument("--rig", metavar="FILE", help="calibration file, relative to SESSION")
    parser.add_argument("--input", choices=("auto", "videos", "images", "pose2d"), help="which data of the session to use")
    parser.add_argument("--weights", choices=("none", "score", "all", "robust"), help="how views are weighted (default robust)")
    parser.add_argument("--raw", action="store_true", help="every time step as it was fused: no smoothing, no bridged gaps")
    parser.add_argument("--person", type=_xy, metavar="X,Y", help="follow the person nearest to this place (world metres)")
    parser.add_argument("--start", type=float, metavar="S", help="begin at this time of the session, seconds")
    parser.add_argument("--end", type=float, metavar="S", help="end at this time of the session, seconds")
    parser.add_argument(
        "--rate", type=float, metavar="HZ", help="output rate; also the frame rate of images and 2D poses that state none"
    )
    parser.add_argument("--outputs", metavar="A,B,...", help="which files to write; see `posefuse plugins`")
    parser.add_argument("--view", action="store_true", help="open the Rerun viewer on the result")


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Track, write, compare with the truth where the session has one."""
    from posefuse.pipeline.reading import is_live

    if is_live(args.session):
        from posefuse.cli.second_solve import second_solve

        return second_solve(args, terminal)
    from posefuse.cli.tracking import track

    return track(args, terminal)


def _xy(text: str) -> tuple[float, float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected X,Y in metres, got {text!r}") from None
    return x, y
