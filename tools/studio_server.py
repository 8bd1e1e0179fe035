"""A studio to try things on: for the images, the walk and the tests that open its pages in a browser."""

from __future__ import annotations

import json
import os
import secrets
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).resolve().parents[1]
CHROMIUM = "/usr/bin/chromium"
# windows of a desk and of a phone, by the ending of images
SIZES = {"": (1280, 800), "_phone": (390, 844)}
# WebGL on the processor, where there is no graphics card; all else of a page is drawn as the browser itself chooses then
GRAPHICS = ("--no-sandbox", "--enable-unsafe-swiftshader")
PATIENCE_S = 240.0
# an option that begins with "-" would be taken for another one
TOKEN = secrets.token_hex(24)
"""Of every studio that this process starts."""
_ports: list[int] = []


def free_port() -> int:
    """A port that no program has."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def server(workspace: Path, port: int, *options: str, log: Path | None = None) -> Iterator[subprocess.Popen[bytes]]:
    """A studio that answers; `options`: more of its command line. `log`: takes what it prints."""
    command = [sys.executable, "-m", "posefuse", "studio", str(workspace), "--port", str(port), "--no-open", "--token", TOKEN]
    command += options
    _ports.append(port)
    # NiceGUI leaves processes of its own behind where it takes itself for a test
    environment = {name: value for name, value in os.environ.items() if name != "PYTEST_CURRENT_TEST"}
    with Path(os.devnull if log is None else log).open("wb") as printed:
        process = subprocess.Popen(command, stdout=printed, stderr=printed, env=environment)
    try:
        until(lambda: _answers(port) or process.poll() is not None, "the studio to answer")
        if process.poll() is not None:
            raise RuntimeError(f"the studio ended with {process.returncode}: {' '.join(command)}")
        yield process
    finally:
        process.terminate()
        process.wait(PATIENCE_S)


def cookies() -> list[Any]:
    """For a browser, as if it had opened the printed address of each studio that was started."""
    return [{"name": name, "value": TOKEN, "url": "http://127.0.0.1"} for port in _ports for name in cookie(port)]


def cookie(port: int) -> dict[str, str]:
    """The token of a studio, for a client without a browser."""
    return {f"posefuse_studio_{port}": TOKEN}


@contextmanager
def stand_in(workspace: Path, cameras: int) -> Iterator[None]:
    """A live session that shows the clip's exact truth, for a machine that is too busy to track."""
    process = subprocess.Popen([sys.executable, str(ROOT / "bench" / "studio_source.py"), str(workspace), str(cameras)])
    try:
        until(lambda: session_of(workspace)[0], "the stand-in")
        yield
    finally:
        process.terminate()
        process.wait(PATIENCE_S)


class Watched:
    """Pages of one browser: what they asked for and what went wrong."""

    def __init__(self, browser: Browser, port: int) -> None:
        self.browser, self.base = browser, f"http://127.0.0.1:{port}"
        self.requests = 0
        self.elsewhere: list[str] = []
        self.errors: list[str] = []

    def page(self, size: tuple[int, int] = SIZES[""], path: str = "") -> Page:
        """A new tab; path: is opened in it."""
        page = self.browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.context.add_cookies(cookies())
        page.on("request", lambda request: self._asked(request.url))
        page.on("websocket", lambda socket: self._asked(socket.url.replace("ws://", "http://", 1)))
        page.on("response", lambda answer: self.errors.append(f"{answer.status} {answer.url}") if answer.status >= 500 else None)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        if path:
            page.goto(self.base + path)
        return page

    def found(self) -> str:
        """Requests and errors, for people."""
        asked = f"{self.requests} requests, {len(self.elsewhere)} elsewhere: {self.elsewhere[:5]}"
        return f"{asked}\nerrors of pages: {self.errors[:5]}"

    def _asked(self, url: str) -> None:
        self.requests += 1
        if not url.startswith((self.base, "data:", "blob:")):
            self.elsewhere.append(url)


@contextmanager
def in_chromium(port: int, chromium: str = CHROMIUM) -> Iterator[Watched]:
    """Pages of the studio at this port; the browser ends with the block."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=GRAPHICS)
        yield Watched(browser, port)
        browser.close()


def until(condition: Callable[[], object], what: str, seconds: float = PATIENCE_S) -> None:
    """Wait; raises TimeoutError that names the condition."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise TimeoutError(f"waited {seconds:g} s for {what}")
        time.sleep(0.1)


def session_of(workspace: Path) -> tuple[str, int]:
    """Job and process of the session that runs."""
    for folder in sorted((workspace / ".posefuse-studio" / "jobs").glob("*-live"), reverse=True):
        file = folder / "state.json"
        state = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
        if state.get("state") == "running":
            return folder.name, int(state["pid"])
    return "", 0


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex(("127.0.0.1", port)) == 0
