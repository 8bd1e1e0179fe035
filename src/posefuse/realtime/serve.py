"""A live session in a process of its own, for `posefuse.live`: the program that uses the poses cannot delay the output rate.

`main` is its entry point; the key of the connection comes on standard input, the plan over the connection.
"""

from __future__ import annotations

import _thread
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Client, Connection

from posefuse.core import LiveOutputConfig, PosefuseError, Rig

from .capture import LiveInput
from .clock import SessionClock
from .config import LiveConfig
from .controls import Controls, Request
from .output_plan import OutputPlan
from .ros_cameras import rig_with_camera_infos
from .session import run_live

CONTROL = "control"


@dataclass(frozen=True, eq=False, kw_only=True)
class ServePlan:
    """What the session is to do; see `run_live`."""

    rig: Rig
    inputs: Sequence[LiveInput]
    config: LiveConfig
    outputs: Mapping[str, LiveOutputConfig]
    duration_s: float | None


@dataclass(frozen=True)
class NewsLine:
    """One line of news."""

    line: str


@dataclass(frozen=True)
class Ended:
    """The session is over; `error` is the reason for a failure, None after a normal end."""

    error: PosefuseError | None


@dataclass(frozen=True)
class Change:
    """Change something while the session runs."""

    request: Request


class StopSession:
    """End the session in an orderly way."""


def serve(connection: Connection) -> None:
    """Run the session that the connection describes until it ends, it is stopped, or no one listens any more."""
    plan: ServePlan = connection.recv()
    controls = Controls()
    threading.Thread(target=_take_requests, args=(connection, controls), daemon=True).start()
    error: PosefuseError | None = None
    try:

        def say(line: str) -> None:
            connection.send(NewsLine(line))

        rig = rig_with_camera_infos(plan.rig, plan.inputs, plan.config.camera_info, say)
        outputs = OutputPlan(rig=rig, clock=SessionClock.begin(), configs=plan.outputs)
        run_live(rig, plan.inputs, plan.config, outputs, plan.duration_s, say, controls=controls)
    except PosefuseError as problem:
        error = problem
    except KeyboardInterrupt:
        pass
    connection.send(Ended(error))


def _take_requests(connection: Connection, controls: Controls) -> None:
    # it also ends when the program that wanted the poses has ended
    with suppress(EOFError, OSError):
        while isinstance(message := connection.recv(), Change):
            controls.ask(message.request)
    _thread.interrupt_main()


def main() -> None:
    """Entry point of the process."""
    with Client(("127.0.0.1", int(sys.argv[1])), authkey=bytes.fromhex(sys.stdin.readline().strip())) as connection:
        connection.send(CONTROL)
        serve(connection)
