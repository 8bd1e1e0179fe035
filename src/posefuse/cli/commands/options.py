"""Options that several commands have, and what their values may be."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any

from posefuse.core import ConfigError


def add_networks(parser: argparse.ArgumentParser) -> None:
    """``--networks NAME|CARD.toml``: short for the settings of the detector that choose its network."""
    parser.add_argument(
        "--networks",
        dest="overrides",
        action=_Networks,
        metavar="NAME|CARD.toml",
        help="2D network: blazepose_lite, blazepose_full (default), blazepose_heavy, blazepose_best, or your own model card "
        "(see docs/networks.md)",
    )


class _Networks(argparse.Action):
    """Adds the settings to those of ``--set``, where they can be changed further."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        from posefuse.detection.build import network_settings

        try:
            added = [f"{key}={value}" for key, value in network_settings(str(values)).items()]
        except ConfigError as error:
            raise argparse.ArgumentError(self, str(error)) from None
        setattr(namespace, self.dest, [*(getattr(namespace, self.dest) or []), *added])


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
