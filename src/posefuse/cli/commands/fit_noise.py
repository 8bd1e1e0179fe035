"""`posefuse fit-noise`: how far off a network of your own is, and where joint centres lie beside its keypoints."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.cli.terminal import Terminal

from .options import count

SUMMARY = "fit noise and joint centres of your own network's model card on simulated people (an hour or more)"
MOST_SCENES = 100


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The card, where scenes are kept, and how many."""
    parser.add_argument("card", type=Path, metavar="CARD.toml", help="model card; see docs/networks.md")
    parser.add_argument(
        "--scenes-in",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for the rendered scenes; later fits use them again",
    )
    parser.add_argument("--scenes", type=count(MOST_SCENES), default=24, metavar="N", help="scenes for the noise (default 24)")
    parser.add_argument(
        "--moving",
        type=count(MOST_SCENES),
        default=16,
        metavar="N",
        help="scenes for the joint centres (default: all 16)",
    )
    parser.add_argument("--engine", choices=("openvino", "onnxruntime"), default="openvino", help="what runs the network")


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Render what is missing, fit, write two files beside the card, and say what to add to it."""
    from posefuse.cli.fitting import fit_card

    return fit_card(args, terminal)
