"""The server of the pages: one process, which only serves; everything long runs elsewhere (see `jobs`)."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Callable
from importlib import import_module
from typing import Any

from posefuse.core import DependencyError, InputError

from .access import AccessMiddleware
from .state import Studio

try:
    # it keeps nothing, but would make a folder where it is started
    os.environ.setdefault("NICEGUI_STORAGE_PATH", os.path.join(tempfile.gettempdir(), "posefuse-studio-nicegui"))  # noqa: PTH118
    # for the QR code
    import segno  # noqa: F401
    import uvicorn
    from fastapi import FastAPI, WebSocket
    from nicegui import app as pages_app
    from nicegui import ui
except ImportError as error:
    raise DependencyError(f'studio: {error.name} is missing; install the extra: pip install "posefuse[studio]"') from None

from .pages import PAGES, StudioPage
from .recording_files import add_routes
from .shell import shell

_RECONNECT_S = 10.0


def application(studio: Studio) -> Any:
    """The ASGI application; `access` is asked first. One per process: NiceGUI has one list of pages."""
    for page in PAGES:
        ui.page(page.path, title=f"{page.title} · posefuse studio")(_builder(studio, page))

    @ui.page("/phone", title="posefuse")
    def phone() -> None:
        import_module("posefuse.studio.pages.phone").build(studio)

    @pages_app.websocket("/studio/stream/{name}")
    async def stream(websocket: WebSocket, name: str) -> None:
        if name not in studio.streams:
            await websocket.close(code=1008, reason="no such stream")
            return
        await websocket.accept()
        # a page that goes away while something is sent to it is not worth a trace
        with contextlib.suppress(RuntimeError):
            await studio.streams[name].serve(websocket)

    add_routes(pages_app, studio.workspace)

    @pages_app.on_startup
    def begin() -> None:
        for link in (studio.live, studio.watch):
            link.begin(asyncio.get_running_loop())

    outer = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    ui.run_with(outer, title="posefuse studio", dark=None, reconnect_timeout=_RECONNECT_S, show_welcome_message=False)
    return AccessMiddleware(outer, studio.access)


def run(studio: Studio, *, show: bool, say: Callable[[str], None]) -> None:
    """Serve until Ctrl-C.

    Args:
        show: open the page in the user's browser. say: called with lines for the terminal.

    Raises:
        InputError: the port is taken, or the address is not of this machine.
    """
    access = studio.access
    listener = _listener(access.host, access.port)
    # images are compressed already: deflating them again would cost the server a core
    config = uvicorn.Config(application(studio), log_level="error", ws_per_message_deflate=False, ws_max_size=2**20)
    say(f"posefuse studio: {access.address()}")
    say(f"workspace {studio.workspace.root}; Ctrl-C ends the server, running sessions and jobs continue")
    if show:
        threading.Timer(1.0, webbrowser.open, (access.address(),)).start()
    with listener:
        uvicorn.Server(config).run(sockets=[listener])


def _listener(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    if os.name == "posix":
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host.strip("[]"), port))
    except OSError as error:
        listener.close()
        raise InputError(f"{host}:{port}: cannot be opened ({error.strerror}); choose another one with --host, --port") from None
    return listener


def _builder(studio: Studio, page: StudioPage) -> Callable[[], None]:
    def build() -> None:
        with shell(studio, page):
            import_module(f"posefuse.studio.pages.{page.module}").build(studio)

    return build
