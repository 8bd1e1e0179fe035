"""The server of the pages: one process, which only serves; everything long runs elsewhere (see `jobs`)."""

from __future__ import annotations

import asyncio
import contextlib
import html
import logging
import mimetypes
import os
import socket
import threading
import webbrowser
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any

from posefuse.core import DependencyError, InputError, PosefuseError
from posefuse.foundation.requests_to_end import HANG_UP, handling, heeded
from posefuse_studio.catalogue import thumbnail

from .workspace import STATE_FOLDER, StudioWorkspace, private_folder, write_private

try:
    # it keeps nothing, but would make a folder where it is started
    os.environ.setdefault("NICEGUI_STORAGE_PATH", str(private_folder() / "nicegui"))
    # FastAPI would send every address that is opened to where variables for other programs point
    os.environ["OTEL_SDK_DISABLED"] = "true"
    # for the QR code
    import segno  # noqa: F401
    import uvicorn
    from fastapi import FastAPI, Request, Response, WebSocket
    from fastapi.responses import FileResponse
    from nicegui import app as pages_app
    from nicegui import run, ui
except ImportError as error:
    raise DependencyError(f'studio: {error.name} is missing; install the extra: pip install "posefuse[studio]"') from None

from .access import AccessMiddleware
from .pages import PAGES, StudioPage
from .shell import REFUSALS, shell
from .state import Studio

# a browser on a machine that is busy may be silent for seconds: a page that is given up too soon loads itself again
_RECONNECT_S = 30.0
# a page from the workspace runs by itself: it can read nothing of the studio and send nothing
_SANDBOX = {"Content-Security-Policy": "sandbox allow-scripts; default-src 'unsafe-inline' data: blob:; connect-src 'none'"}


def asgi_application(studio: Studio) -> Any:
    """The ASGI application; `access` is asked first. One per process: NiceGUI has one list of pages."""
    for page in PAGES:
        ui.page(page.path, title=f"{page.title} · posefuse studio")(_builder(studio, page))
    ui.page("/phone", title="posefuse")(lambda: import_module("posefuse_studio.pages.live").build_phone(studio))

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
    # what a page shows to its user is no fault of the program
    logging.getLogger("nicegui").addFilter(lambda record: not (record.exc_info and isinstance(record.exc_info[1], REFUSALS)))
    pages_app.on_startup(studio.begin)
    run.process_pool_start_method = "spawn"
    outer = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)
    ui.run_with(outer, title="posefuse studio", dark=None, reconnect_timeout=_RECONNECT_S, show_welcome_message=False)
    return AccessMiddleware(outer, studio.access)


def add_routes(app: Any, workspace: StudioWorkspace) -> None:
    """Serve ``/studio/thumbnail?name=RECORDING`` and ``/studio/file?name=FILE``."""

    def missing(request: Request, error: Exception) -> Response:
        return Response(str(error), status_code=404, media_type="text/plain")

    async def small_image(name: str) -> Response:
        image = await asyncio.to_thread(thumbnail, workspace.existing(name), workspace.root)
        return Response(image, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=60"})

    def file(name: str) -> Response:
        path = workspace.existing(name)
        # the state of jobs is private; some disks take capital letters for small ones
        if not path.is_file() or STATE_FOLDER in (part.lower() for part in path.parts):
            raise InputError(f"{name}: not a file")
        if path.suffix == ".html":
            return FileResponse(path, media_type="text/html", headers=_SANDBOX)
        kind = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
        return FileResponse(path, media_type=kind, filename=path.name)

    app.exception_handler(PosefuseError)(missing)
    app.get("/studio/thumbnail")(small_image)
    app.get("/studio/file")(file)


def run_server(studio: Studio, *, show: bool, say: Callable[[str], None]) -> None:
    """Serve until Ctrl-C.

    Args:
        show: open the page in the user's browser. say: called with lines for the terminal.

    Raises:
        InputError: the port is taken, or the address is not of this machine.
    """
    access = studio.access
    listener = _listener(access.host, access.port)
    # images are compressed already: deflating them again would cost the server a core
    config = uvicorn.Config(
        asgi_application(studio), log_level="error", ws_per_message_deflate=False, ws_max_size=2**20, date_header=False
    )
    say(f"posefuse studio: {access.address()}")
    say(f"workspace {studio.workspace.root}; Ctrl-C ends the server, running sessions and jobs continue")
    with listener, _opening_page(studio) if show else contextlib.nullcontext():
        _Server(config).run(sockets=[listener])


@contextlib.contextmanager
def _opening_page(studio: Studio) -> Iterator[None]:
    """Have a browser go to the studio from a file that this user alone can read: all users see the browser's command line.

    It lies in the workspace, as some systems keep browsers from reading hidden folders of the user.
    """
    access = studio.access
    page = studio.workspace.folder(STATE_FOLDER) / f"open-{access.port}.html"
    write_private(page, f'<!doctype html><meta http-equiv="refresh" content="0; url={html.escape(access.address())}">')
    threading.Timer(1.0, webbrowser.open, (page.as_uri(),)).start()
    try:
        yield
    finally:
        page.unlink(missing_ok=True)


def _listener(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server((host.strip("[]"), port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        why = str(error.strerror).partition(" (while")[0]
        raise InputError(f"{host}:{port}: cannot be opened ({why}); choose another one with --host, --port") from None


def _builder(studio: Studio, page: StudioPage) -> Callable[[], None]:
    def build() -> None:
        with shell(studio, page):
            import_module(f"posefuse_studio.pages.{page.module}").build(studio)

    return build


class _Server(uvicorn.Server):
    """Ends when the terminal is closed, too: what its usual handler raises would end up in whatever the server does just then."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """See uvicorn."""
        with super().capture_signals(), handling(heeded([HANG_UP] if HANG_UP else []), self.handle_exit):
            yield

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """See uvicorn, which after a second Ctrl-C leaves the application running: its cancellation would print a trace."""
        await super().shutdown(sockets)
        if self.force_exit:
            await self.lifespan.shutdown()
