"""`posefuse simulate`: a scene file to a session with exact truth."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

from .options import count

MOST_PROCESSES = 1024
SUMMARY = "render what every camera would have recorded of a scene, with the truth beside it"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The scene and the session folder."""
    parser.add_argument("scene", type=Path, metavar="SCENE.yaml", help="scene file; see examples/scenes and docs/simulation.md")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="session folder; an unfinished one is resumed")
    parser.add_argument("--force", action="store_true", help="render anew even if DIR is finished")
    parser.add_argument("--workers", type=count(MOST_PROCESSES), metavar="N", help="processes that render; default: one per core")


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Simulate and say what was made."""
    from posefuse.cli.simulating import simulate_session

    return simulate_session(args, terminal)
