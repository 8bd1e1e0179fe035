"""`posefuse view`: look at a result."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

SUMMARY = "look at a result in the Rerun viewer"


def add_arguments(parser: argparse.ArgumentParser) -> None:
<<<<<<< HEAD
    """The result folder."""
    parser.add_argument(
        "result", type=Path, metavar="DIR", help="folder written by `posefuse track`, or the .mcap of `posefuse live`"
    )
=======
    """The result folder and the session it was made from."""
    parser.add_argument("result", type=Path, metavar="DIR", help="folder written by `posefuse track`")
    parser.add_argument(
        "--session", type=Path, metavar="FOLDER",
        help="session the result was made from, for its images (default: a folder of its name near the result or here)",
    )  # fmt: skip
>>>>>>> main


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Show the result until the viewer is closed."""
<<<<<<< HEAD
    from posefuse.outputs import view_recording
    from posefuse.pipeline.reading import read_result

    return {"viewed": view_recording(args.result, lambda path: read_result(path, terminal.warn))}
=======
    from posefuse.cli.viewing import view_result

    return {"viewed": view_result(args.result, args.session, terminal)}
>>>>>>> main
