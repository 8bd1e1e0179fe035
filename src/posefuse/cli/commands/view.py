"""`posefuse view`: look at a result."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

SUMMARY = "look at a result in the Rerun viewer"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The result and the session it was made from."""
    parser.add_argument("result", type=Path, metavar="DIR", help="result folder of `posefuse track`, or .mcap of `posefuse live`")
    parser.add_argument(
        "--session", type=Path, metavar="FOLDER",
        help="session the result was made from, for its images (default: a folder of its name near the result or here)",
    )  # fmt: skip


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Show the result until the viewer is closed."""
    from posefuse.cli.viewing import view_result

    return {"viewed": view_result(args.result, args.session, terminal)}
