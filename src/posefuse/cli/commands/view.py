"""`posefuse view`: look at a result."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

SUMMARY = "look at a result in the Rerun viewer"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The result folder."""
    parser.add_argument(
        "result", type=Path, metavar="DIR", help="folder written by `posefuse track`, or the .mcap of `posefuse live`"
    )


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Show the result until the viewer is closed."""
    from posefuse.outputs import view_recording
    from posefuse.pipeline.reading import read_result

    return {"viewed": view_recording(args.result, lambda path: read_result(path, terminal.warn))}
