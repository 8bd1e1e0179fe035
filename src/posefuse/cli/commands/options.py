"""Options that several commands have."""

from __future__ import annotations

import argparse


def add_networks(parser: argparse.ArgumentParser) -> None:
    """``--networks NAME``: short for the setting of the default 2D estimator that chooses its networks."""
    parser.add_argument(
        "--networks",
        dest="overrides",
        action="append",
        type=lambda name: f"detector.options.landmarks={name}",
        metavar="NAME",
        help="2D networks: blazepose_lite, blazepose_full (default), blazepose_heavy, blazepose_best, or your own card (TOML)",
    )
