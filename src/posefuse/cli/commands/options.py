"""Options that several commands have."""

from __future__ import annotations

import argparse
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

BUNDLED = ("blazepose_lite", "blazepose_full", "blazepose_heavy", "blazepose_best")
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
        text: str | Sequence[Any] = values
        try:
            added = networks_settings(str(text))
        except ValueError as error:
            raise argparse.ArgumentError(self, str(error)) from None
        setattr(namespace, self.dest, [*(getattr(namespace, self.dest) or []), *added])
