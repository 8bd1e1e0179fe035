"""Dead-man's switches: each only reports; whether the robot moves is decided by the gate."""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Protocol

from posefuse.core import ConfigError, MessageError, SourceError
from posefuse.core.extras import package_of_extra

from .gate import Beat, Pressed
from .settings import AHEAD_S, RosPlan
from .values import OperatorView

_MOST_JOY_BYTES = 10_000
_JOY = "sensor_msgs/msg/Joy"


class DeadMan(Protocol):
    """A switch that a person must hold."""

    @property
    def hint(self) -> str:
        """How to use it, in one line."""
        ...

    def poll(self, now_ns: int, view: OperatorView | None) -> Pressed:
        """What came since the last call; never waits. `view`: the operator in the newest pose."""
        ...

    def close(self) -> None:
        """Safe to call twice."""
        ...


class RosJoySwitch:
    """Button 0 of `sensor_msgs/Joy` held: follow. 1: gripper. 2: emergency stop. 3: reset (`DeadMan`).

    Each message with the button down is a heartbeat; joy_node repeats at 20 Hz by default.

    Messages count by their source time on this machine's clock, so the clocks of two machines must agree.
    """

    def __init__(self, topic: str, ros: RosPlan) -> None:
        self.hint = f"hold button 0 of {topic} to move; button 1: gripper, 2: emergency stop, 3: reset, Ctrl-C: end"
        self._node = ros.node("posefuse_deadman")
        self._reader = self._node.reader(package_of_extra("posefuse_ros.topics", "ros").Topic(topic, _JOY, depth=10))
        self._decode = package_of_extra("posefuse_ros.types", "ros").decode
        self._down, self._seq, self._grip = frozenset[int](), 0, False

    def poll(self, now_ns: int, view: OperatorView | None) -> Pressed:
        """See `DeadMan`; unreadable messages count as released."""
        heartbeats, events = [], set[int]()
        offset_ns = time.time_ns() - now_ns
        for sample in self._reader.take():
            try:
                buttons = list(self._decode(sample.raw, _JOY, _MOST_JOY_BYTES).buttons)
            except (MessageError, AttributeError):
                continue
            down = frozenset(i for i, pressed in enumerate(buttons[:16]) if pressed)
            events |= down - self._down
            self._grip ^= 1 in down - self._down
            self._down = down
            if 0 in down:
                sent_ns = sample.sent_ns - offset_ns
                # a stamp a little ahead is of now: clocks of two machines differ
                if sent_ns <= now_ns + AHEAD_S * 1e9:
                    sent_ns = min(sent_ns, now_ns)
                self._seq += 1
                heartbeats.append(Beat(seq=self._seq, sent_ns=sent_ns, grip=self._grip))
        return Pressed(heartbeats=tuple(heartbeats), emergency=2 in events, reset=3 in events)

    def close(self) -> None:
        """See `DeadMan`."""
        self._node.close()


_MOST_BYTES = 2000
# numbers given out are remembered so long
_REMEMBER = 1000


class WebSwitch:
    """A page of this machine with a large button (`DeadMan`). url: where it is; only who knows its key can press.

    No other machine reaches it. A closed page or a late report releases the button. Every report echoes the newest number that
    the server has given out: one that waited somewhere carries an old number, and is as old as that number.
    """

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
            heartbeats, events = tuple(self._beats), set(self._events)
            self._beats.clear()
            self._events.clear()
        return Pressed(heartbeats=heartbeats, emergency="stop" in events, reset="reset" in events)

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
        page = files(__package__).joinpath("deadman.html").read_bytes()

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"
            # an answer is two writes: the second would wait 40 ms for the receipt of the first, which makes heartbeats too old
            disable_nagle_algorithm = True

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


KINDS = "ros:/joy, web, web:PORT"


def open_deadman(text: str | DeadMan, ros: Callable[[], RosPlan] = RosPlan) -> DeadMan:
    """The switch of ``--deadman``; one that is open already is returned. ros: where its topic is.

    Raises:
        ConfigError: no such switch. SourceError: it cannot be opened.
    """
    if not isinstance(text, str):
        return text
    kind, _, where = text.partition(":")
    if kind == "ros" and where.startswith("/"):
        return RosJoySwitch(where, ros())
    if kind == "web" and (not where or where.isdecimal()):
        return WebSwitch(int(where or 0))
    raise ConfigError(f"--deadman {text}: expected one of {KINDS}")
