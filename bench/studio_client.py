"""A page of the studio that draws nothing: the server's work for a browser on another computer, without that browser's.

    python bench/studio_client.py http://127.0.0.1:8765 TOKEN

It opens the live page, takes part in NiceGUI's messages as the page does, and receives the stream of images and poses. Each line
on its standard input asks for what came so far: one JSON object by kind of message. It ends with its input.
"""

from __future__ import annotations

import ast
import asyncio
import json
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlencode, urlsplit
from uuid import uuid4

_KINDS = {"image": "images", "poses": "poses", "values": "values"}


class QuietPage:
    """The bench's side of such a page, which is a process of its own."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def counts(self) -> Counter[str]:
        """Messages so far: ``images`` of all cameras, ``poses``, ``values``, and ``page`` of NiceGUI."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return Counter(json.loads(self._process.stdout.readline()))


@contextmanager
def quiet_page(base: str, token: str) -> Iterator[QuietPage]:
    """Open one; it is connected when this returns."""
    process = subprocess.Popen([sys.executable, str(Path(__file__)), base, token], stdin=-1, stdout=-1, text=True)
    page = QuietPage(process)
    try:
        while not page.counts()["poses"]:
            time.sleep(0.1)
        yield page
    finally:
        process.terminate()
        process.wait(60)


async def main(base: str, token: str) -> None:
    """Until the input ends."""
    import aiohttp
    import socketio

    counts: Counter[str] = Counter()
    # by the header: it keeps no cookies of a host without a name
    async with aiohttp.ClientSession(headers={"cookie": f"posefuse_studio_{urlsplit(base).port}={token}"}) as http:
        async with http.get(f"{base}/live") as answer:
            found = re.search(r"query: (\{.*?\}),\n", await answer.text())
        assert found is not None, "no page of NiceGUI"
        query: dict[str, Any] = {**ast.literal_eval(found[1]), "tab_id": uuid4(), "document_id": uuid4()}
        query["implicit_handshake"] = "true"
        events = socketio.AsyncClient(http_session=http)
        events.on("*", lambda *_: counts.update(["page"]))
        await events.connect(f"{base}?{urlencode(query)}", socketio_path="/_nicegui_ws/socket.io", transports=["websocket"])
        receiving = asyncio.create_task(_receive(http, base, counts))
        loop = asyncio.get_running_loop()
        while await loop.run_in_executor(None, sys.stdin.readline):
            print(json.dumps(counts), flush=True)
        receiving.cancel()
        await events.disconnect()


async def _receive(http: Any, base: str, counts: Counter[str]) -> None:
    async with http.ws_connect(f"{base}/studio/stream/live", max_msg_size=0) as socket:
        async for message in socket:
            kind = json.loads(message.data[4 : 4 + int.from_bytes(message.data[:4], "little")])["kind"]
            counts[_KINDS.get(kind, "other")] += 1


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
