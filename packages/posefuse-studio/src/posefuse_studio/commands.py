"""`posefuse studio`: the browser page."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from posefuse.cli.options import Figures, Shown, count


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
    from posefuse_studio.app import run_server  # isort: skip - it names the extra where that is missing
    from posefuse_studio.access import Access
    from posefuse_studio.state import Studio
    from posefuse_studio.workspace import StudioWorkspace

    served = Studio(StudioWorkspace(workspace), Access.of(host, port, token))
    run_server(served, show=open_page, say=terminal.note)
    return {"workspace": str(served.workspace.root), "address": served.access.address()}
