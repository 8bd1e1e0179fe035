"""What pages fetch by address: small images of recordings, and files that posefuse made in the workspace."""

from __future__ import annotations

import asyncio
import mimetypes
from typing import Any

from fastapi import Response
from fastapi.responses import FileResponse

from posefuse.core import PosefuseError
from posefuse.pipeline.catalogue import thumbnail

from .workspace import STATE_FOLDER, StudioWorkspace

# a page from the workspace runs by itself: it can read nothing of the studio and send nothing
_SANDBOX = {"Content-Security-Policy": "sandbox allow-scripts; default-src 'unsafe-inline' data: blob:; connect-src 'none'"}


def add_routes(app: Any, workspace: StudioWorkspace) -> None:
    """Serve ``/studio/thumbnail?name=RECORDING`` and ``/studio/file?name=FILE``."""

    async def small_picture(name: str) -> Response:
        try:
            picture = await asyncio.to_thread(thumbnail, workspace.existing(name), workspace.root)
        except PosefuseError as error:
            return Response(str(error), status_code=404, media_type="text/plain")
        return Response(picture, media_type="image/jpeg", headers={"Cache-Control": "private, max-age=60"})

    def file(name: str) -> Response:
        try:
            path = workspace.existing(name)
        except PosefuseError as error:
            return Response(str(error), status_code=404, media_type="text/plain")
        # the state of jobs has keys of sessions; some disks take capital letters for small ones
        if not path.is_file() or STATE_FOLDER in (part.lower() for part in path.parts):
            return Response(f"{name}: not a file", status_code=404, media_type="text/plain")
        if path.suffix == ".html":
            return FileResponse(path, media_type="text/html", headers=_SANDBOX)
        kind = mimetypes.guess_type(path.name)[0] or "application/octet-stream"
        return FileResponse(path, media_type=kind, filename=path.name)

    app.get("/studio/thumbnail")(small_picture)
    app.get("/studio/file")(file)
