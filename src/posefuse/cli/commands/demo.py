"""`posefuse demo`: the whole pipeline on the clip that comes with the package."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

SUMMARY = "track the bundled clip of four cameras: see in a minute that everything works"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Where to."""
    parser.add_argument("--out", type=Path, default=Path("posefuse-demo"), metavar="DIR", help="default ./posefuse-demo")
    parser.add_argument("--force", action="store_true", help="replace DIR if it is there")


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Track the clip; what to do next is said at the end."""
    from posefuse.cli.demo import demo

    return demo(args.out, args.force, terminal)
