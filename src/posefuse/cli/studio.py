"""What `posefuse studio` does."""

from __future__ import annotations

from pathlib import Path

from .options.shared import Figures
from .terminal import Terminal


def serve_studio(folder: Path, host: str, port: int, token: str, show: bool, terminal: Terminal) -> Figures:
    """Serve the pages of a workspace until Ctrl-C.

    Raises:
        DependencyError: without the extra ``studio``. InputError: no such folder, or the port is taken.
    """
    from posefuse.studio.access import Access
    from posefuse.studio.app import run_server
    from posefuse.studio.state import Studio
    from posefuse.studio.workspace import StudioWorkspace

    studio = Studio.of(StudioWorkspace(folder), Access.of(host, port, token))
    run_server(studio, show=show, say=terminal.note)
    return {"workspace": str(studio.workspace.root), "address": studio.access.address()}
