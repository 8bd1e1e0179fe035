"""A button on a page of this machine; no other machine reaches it. A closed page or a late report releases the button.

Every report echoes the newest number that the server has given out. A report that waited somewhere carries an old number, and is
as old as that number.
"""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections import deque
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files

from posefuse.core import SourceError
from posefuse.teleoperation.heartbeats import Beat
from posefuse.teleoperation.values import OperatorView

from .protocol import Pressed

_MOST_BYTES = 2000
# numbers given out are remembered so long
_REMEMBER = 1000


class WebSwitch:
    """A page with a large button (`DeadMan`). url: where it is; only who knows its key can press."""

    def __init__(self, port: int = 0, host: str = "127.0.0.1") -> None:
        self._key = secrets.token_urlsafe(12)
        self._lock, self._beats, self._events = threading.Lock(), deque[Beat](maxlen=100), set[str]()
        self._given: dict[int, int] = {}
        self._number = 0
        try:
            self._server = ThreadingHTTPServer((host, port), self._handler())
        except OSError as error:
            raise SourceError(f"--deadman web:{port}: cannot listen ({error.strerror})") from None
        self._server.daemon_threads = True
        self.url = f"http://{host}:{self._server.server_address[1]}/{self._key}/"
        self.hint = f"open {self.url} and hold the button to move; Ctrl-C: end"
        threading.Thread(target=self._server.serve_forever, name="deadman", daemon=True).start()

    def poll(self, now_ns: int, view: OperatorView | None) -> Pressed:
        """See `DeadMan`."""
        with self._lock:
            beats, events = tuple(self._beats), set(self._events)
            self._beats.clear()
            self._events.clear()
        return Pressed(beats=beats, emergency="stop" in events, reset="reset" in events)

    def close(self) -> None:
        """See `DeadMan`."""
        self._server.shutdown()
        self._server.server_close()

    def report(self, text: str) -> str:
        """Take one report of the page in; the answer carries the next number. Anything malformed counts as let go."""
        try:
            sent = json.loads(text)
            number, held, grip, event = int(sent["echo"]), sent["held"] is True, sent["grip"] is True, str(sent.get("event", ""))
        except (ValueError, TypeError, KeyError, OverflowError):
            number, held, grip, event = -1, False, False, ""
        with self._lock:
            given_ns = self._given.pop(number, None)
            if event in ("stop", "reset"):
                self._events.add(event)
            if held and given_ns is not None:
                self._beats.append(Beat(seq=number, sent_ns=given_ns, grip=grip))
            self._number += 1
            self._given[self._number] = time.monotonic_ns()
            self._given.pop(self._number - _REMEMBER, None)
            return json.dumps({"echo": self._number})

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        switch = self
        page = files(__package__).joinpath("page.html").read_bytes()

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                good = self.path == f"/{switch._key}/"
                self._answer(200 if good else 404, page if good else b"", "text/html; charset=utf-8")

            def do_POST(self) -> None:
                length = self.headers.get("Content-Length", "")
                if self.path != f"/{switch._key}/beat" or not length.isdecimal() or int(length) > _MOST_BYTES:
                    self.close_connection = True
                    return self._answer(404, b"", "text/plain")
                text = self.rfile.read(int(length)).decode("utf-8", "replace")
                return self._answer(200, switch.report(text).encode(), "application/json")

            def log_message(self, format: str, *args: object) -> None:
                pass

            def _answer(self, code: int, body: bytes, kind: str) -> None:
                self.send_response(code)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(body)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(body)

        return Handler
