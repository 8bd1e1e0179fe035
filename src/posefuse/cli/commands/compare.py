"""`posefuse compare`: two recordings of one movement, by whatever systems."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

from .options import positive

MOST_S = 86_400.0
SUMMARY = "compare recordings (posefuse result or .mcap, TRC, C3D, CSV, MVNX): aligned in time and space, error per point, drift"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The two recordings and how to align them."""
    parser.add_argument(
        "a", type=Path, metavar="A", help="result folder, .mcap, .trc, .c3d, .csv or .mvnx: the one compared with"
    )
    parser.add_argument("b", type=Path, metavar="B", help="the one that is brought onto A")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write compare.html and compare.json there")
    parser.add_argument("--person", type=int, metavar="ID", help="which person of files that hold several")
    parser.add_argument("--scale", action="store_true", help="also find B's scale")
    parser.add_argument("--no-time", action="store_true", help="times are the same clock's")
    parser.add_argument("--no-space", action="store_true", help="coordinates are the same system's")
    parser.add_argument(
        "--align-first", type=positive(MOST_S), metavar="S", help="align in space by the first S seconds, so that drift shows"
    )


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Compare, show, write."""
    from posefuse.cli.comparing import compare_files

    return compare_files(args, terminal)
