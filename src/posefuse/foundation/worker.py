"""A process of its own with a channel: started, watched, started again when it died, asked to end, ended."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from .channel import Channel, ChannelClosed
from .platform import message_sockets
from .requests_to_end import leave_requests_to_parent

_FIRST_RETRY_S, _LONGEST_RETRY_S = 0.2, 10.0
# a process that has worked for so long was well, and its death is a new trouble
_WELL_S = 30.0
_DEATH_S, _KILLED_S = 0.2, 1.0
_LOOK_S = 30.0
# a parent that has not asked for so long was stopped itself
_STOPPED_S = 1.0


class Worker:
    """Runs ``target(channel, *arguments)`` in a fresh interpreter, which its parent alone ends.

    Ctrl-C and a closed terminal do not reach it, and SIGTERM is left to its parent (`leave_requests_to_parent`). When its parent
    is gone, killed even, its channel is closed. No method waits unless it is asked to.

    Args:
        target: a function of a module, not of the program itself. environment: variables set for the process.
        closed_s: so long a process that has closed its channel may take to end by itself before it is killed.

    Attributes:
        channel: of the process while one runs. pid: of the newest process; 0 before the first.
        running: whether a process was started and is not known to have ended. trouble: how the last one ended; may be cleared.
        starts, deaths: how often it was started, and ended without being asked to.
        started_s: monotonic time of the newest start.
    """

    def __init__(
        self,
        target: Callable[..., None],
        environment: Mapping[str, str] = MappingProxyType({}),
        *,
        closed_s: float = _DEATH_S,
    ) -> None:
        self._target, self._environment, self._closed_s = target, environment, closed_s
        self._process: subprocess.Popen[bytes] | None = None
        self._retry_s, self._again_s = _FIRST_RETRY_S, 0.0
        self.channel: Channel
        self.running, self.trouble = False, ""
        self.pid = self.starts = self.deaths = 0
        self.started_s = self._received_s = self._asked_s = 0.0

    def start(self, *arguments: Any) -> None:
        """Begin; `send` and `receive` may be used at once."""
        self._process, self.channel = _started({**os.environ, **self._environment})
        self.pid = self._process.pid
        self.running = True
        self.starts += 1
        self.started_s = self._received_s = self._asked_s = time.monotonic()
        # what is sent may only be found there
        self.send(sys.path)
        self.send((self._target, arguments))

    def send(self, value: Any, wait_s: float = 0.0) -> bool:
        """Whether the message could be handed over within `wait_s`; False when the process is gone, too."""
        try:
            return self.running and self.channel.send(value, wait_s)
        except ChannelClosed:
            self._died()
            return False

    def receive(self) -> Any | None:
        """The oldest message; None when there is none now, or no process any more (see `running`)."""
        try:
            message = self.channel.receive() if self.running else None
        except ChannelClosed:
            self._died()
            return None
        if message is not None:
            self._received_s = time.monotonic()
        return message

    def silent_s(self) -> float:
        """For how long no message has come; to be asked several times a second.

        A time in which this process was stopped itself (a container that is paused, Ctrl-Z) does not count: then all were.
        """
        now_s = time.monotonic()
        if now_s - self._asked_s > _STOPPED_S:
            self._received_s = now_s
        self._asked_s = now_s
        return now_s - self._received_s

    def wait(self, timeout_s: float) -> bool:
        """Wait until something can be received; False at once where no process runs."""
        return self.running and self.channel.wait(timeout_s)

    def fail(self, why: str) -> None:
        """End a process that does not do its work; `why` is its trouble."""
        assert self._process is not None
        self._process.kill()
        self.running, self.trouble = False, why
        self.channel.close()
        self.deaths += 1
        now_s = time.monotonic()
        self._retry_s = _FIRST_RETRY_S if now_s - self.started_s > _WELL_S else self._retry_s
        self._again_s = now_s + self._retry_s
        self._retry_s = min(2 * self._retry_s, _LONGEST_RETRY_S)

    def due(self) -> bool:
        """Whether to start it again now: after a longer and longer time, and not before the former one is gone."""
        if self.running or time.monotonic() < self._again_s:
            return False
        return self._process is None or self._process.poll() is not None

    def end(self, wait_s: float) -> None:
        """Wait for a process that was asked to end; kill one that does not. Safe to call twice."""
        if self._process is None:
            return
        self.running = False
        if not _gone(self._process, wait_s):
            self._process.kill()
            # on a machine with no time to spare a killed process may be there a while
            _gone(self._process, _KILLED_S)
        self.channel.close()

    def _died(self) -> None:
        process = self._process
        assert process is not None
        _gone(process, self._closed_s)
        code = process.returncode
        how = f"by signal {signal.Signals(-code).name}" if code is not None and code < 0 else f"with status {code}"
        self.fail(f"process {self.pid} ended {how}")


def _gone(process: subprocess.Popen[bytes], wait_s: float) -> bool:
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(wait_s)
    return process.returncode is not None


def _started(environment: Mapping[str, str]) -> tuple[subprocess.Popen[bytes], Channel]:
    """A new interpreter that calls `main`, in a session of its own, and our end of its channel."""
    ours, theirs = message_sockets()
    with theirs:
        command = [sys.executable, "-c", f"from {__name__} import main; main()", str(theirs.fileno())]
        if sys.platform == "win32":
            process = subprocess.Popen(command, stdin=subprocess.PIPE, env=environment)
            assert process.stdin is not None
            with process.stdin as pipe:
                pipe.write(theirs.share(process.pid))
        else:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, env=environment, pass_fds=[theirs.fileno()], start_new_session=True
            )
    return process, Channel(ours)


def main() -> None:
    """Entry point of the process."""
    leave_requests_to_parent()
    if sys.platform == "win32":
        channel = Channel(socket.fromshare(sys.stdin.buffer.read()))
    else:
        channel = Channel(socket.socket(fileno=int(sys.argv[1])))
    with contextlib.suppress(ChannelClosed):
        sys.path[:] = _received(channel)
        target, arguments = _received(channel)
        target(channel, *arguments)
    # a thread that hangs in a driver, a viewer or a network must not keep the process
    sys.stdout.flush()
    os._exit(0)


def _received(channel: Channel) -> Any:
    while (message := channel.receive()) is None:
        channel.wait(_LOOK_S)
    return message
