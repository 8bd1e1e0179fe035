"""`posefuse node`: one live session on several machines."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

from . import live

SUMMARY = "a live session on several machines: `node camera` beside the cameras, `node fusion` anywhere"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Which part this machine plays, and what `posefuse live` takes."""
    parser.add_argument("part", choices=("camera", "fusion"), help="camera: send 2D poses; fusion: make 3D of them")
    parser.add_argument("rig", type=Path, metavar="RIG", help="calibration file of all cameras, the same on every machine")
    parser.add_argument(
        "--source", action="append", default=[], metavar="CAMERA=KIND:WHERE", help="camera: see `posefuse live --help`"
    )
    parser.add_argument("--name", default="1", help="camera: tells this machine's node apart from others")
    parser.add_argument(
        "--zero",
        type=float,
        metavar="UNIX_S",
        help="camera: when recorded and simulated sources begin, the same on every machine",
    )
    parser.add_argument("--fault", action="append", default=[], metavar="CAMERA=KIND@START[-END]", help="camera: fail on purpose")
    live.add_timing(parser)
    live.add_outputs(parser)
    live.add_settings(parser)


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Run until the time is over, the sources end, or Ctrl-C."""
    from posefuse.cli.nodes import camera_node, fusion_node

    return camera_node(args, terminal) if args.part == "camera" else fusion_node(args, terminal)
