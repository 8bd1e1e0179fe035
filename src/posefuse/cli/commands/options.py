"""Options that several commands have, and what their values may be."""

from __future__ import annotations

import argparse
import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

# kinds of cards that the default detector reads; all others are networks of the user
_BLAZEPOSE_KINDS = ("heatmap_landmarks", "landmark_ensemble")


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


def networks_settings(text: str) -> list[str]:
    """KEY=VALUE settings of the detector for a bundled network's name or a model card.

    Raises:
        ValueError: a card that cannot be read.
    """
    if not text.endswith(".toml"):
        return [f"detector.options.landmarks={text}"]
    path = Path(text).absolute()
    try:
        kind = tomllib.loads(path.read_text(encoding="utf-8")).get("kind")
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{text}: not a model card that can be read ({error})") from None
    if kind in _BLAZEPOSE_KINDS:
        return [f"detector.options.landmarks={path}"]
    return ["detector.name=onnx", f"detector.options.card={path}"]


class _Networks(argparse.Action):
    """Adds the settings to those of ``--set``, where they can be changed further."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, option: str | None = None
    ) -> None:
        try:
            added = networks_settings(str(values))
        except ValueError as error:
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
