"""`posefuse doctor`, `models`, `plugins` and `studio`: what this machine has."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from posefuse.cli.options import Figures, Shown, count
from posefuse.cli.terminal import Terminal

if TYPE_CHECKING:
    from posefuse.detection.card import ModelCard

MOST_MEASURED = 1000.0
_FROM_HELP = "A wheel, npm archive, model file or folder instead of a download; with no MODEL, all that it holds."


def doctor(*, terminal: Shown) -> Figures:
    """Check what works on this machine, and list what to install for the rest.

    Needed things that fail are marked MISSING; the command itself succeeds.
    """
    from posefuse.cli.machine import machine_checks

    checks = machine_checks()
    rows = [("ok" if c.ok else "MISSING" if c.needed else "no", c.name, c.found, "" if c.ok else c.cure) for c in checks]
    terminal.table("This machine", ("", "what", "found", "what to do"), rows)
    ready = all(check.ok for check in checks if check.needed)
    terminal.note("Ready: `posefuse track SESSION --out DIR` will work." if ready else "Not ready: see the lines marked MISSING.")
    return {
        "ready": ready,
        "checks": [{"name": c.name, "ok": c.ok, "needed": c.needed, "found": c.found, "cure": c.cure} for c in checks],
    }


def plugins(*, terminal: Shown) -> Figures:
    """List the cameras, detectors and outputs that can be used, bundled and from other packages.

    A plug-in that cannot be used is listed with the reason.
    """
    from posefuse.foundation.plugins import GROUPS, list_plugins, option_names

    found = [plugin for kind in GROUPS for plugin in list_plugins(kind)]
    rows = [(p.kind, p.name, p.package, p.reason or ", ".join(option_names(p)) or "-") for p in found]
    terminal.table("Plug-ins", ("kind", "name", "package", "options, or why it cannot be used"), rows)
    return {
        "plugins": [
            {"kind": p.kind, "name": p.name, "package": p.package, "options": option_names(p), "reason": p.reason or None}
            for p in found
        ]
    }


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
    from posefuse.detection.card import list_cards
    from posefuse.detection.files import fetch_all, model_path, status
    from posefuse.foundation.places import default_cache_dir

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
    from posefuse.detection.card import list_cards, read_card
    from posefuse.detection.files import holds

    if source is not None and not source.exists():
        raise ModelError(f"{source}: no such archive, model file or folder")
    if names:
        return [read_card(name) for name in names]
    held = [card for card in list_cards() if source is not None and holds(source, card)]
    return held or default_cards()


def studio(
    workspace: Annotated[Path, Parameter(metavar="FOLDER")] = Path(),
    /,
    *,
    port: Annotated[int, count(65535)] = 8765,
    host: str = "127.0.0.1",
    token: str = "",
    open_page: Annotated[bool, Parameter(name="--open", negative="--no-open")] = True,
    terminal: Shown,
) -> Figures:
    """Open a local page in the browser: cameras, calibration, live, recordings (extra: studio).

    Args:
        workspace: Folder whose files the page reads and writes (default: this one); nothing outside it.
        port: Port of the page.
        host: Address to bind to; others than 127.0.0.1 can be reached from other machines.
        token: Ask for this token, of 16 characters or more, instead of one made at random; it is in the address that is printed.
        open_page: Open the page in the browser.
    """
    from posefuse.studio.access import Access
    from posefuse.studio.app import run_server
    from posefuse.studio.state import Studio
    from posefuse.studio.workspace import StudioWorkspace

    served = Studio.of(StudioWorkspace(workspace), Access.of(host, port, token))
    run_server(served, show=open_page, say=terminal.note)
    return {"workspace": str(served.workspace.root), "address": served.access.address()}
