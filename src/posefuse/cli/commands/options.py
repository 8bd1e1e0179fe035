"""Options that several commands have, and what their values may be."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable


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


def positive(most: float) -> Callable[[str], float]:
    """For ``type=`` of an option: a number above 0 and at most `most`; NaN and infinity are refused."""

    def number(text: str) -> float:
        value = _number(text)
        if not 0 < value <= most:
            raise argparse.ArgumentTypeError(f"expected a number > 0 and <= {most:g}, got {text!r}")
        return value

    return number


def count(most: int) -> Callable[[str], int]:
    """For ``type=`` of an option: a whole number from 1 to `most`."""

    def whole(text: str) -> int:
        value = _number(text)
        if not (1 <= value <= most and value == int(value)):
            raise argparse.ArgumentTypeError(f"expected a whole number from 1 to {most}, got {text!r}")
        return int(value)

    return whole


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
