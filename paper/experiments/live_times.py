"""The live pipeline on a rendered session at the pace of the clock: when every view passed every stage."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

import numpy as np

from posefuse.core import Array, SourceError
from posefuse.formats import read_rig
from posefuse.outputs.live import JsonConfig
from posefuse.realtime import LiveConfig, OutputPlan, SessionClock, ViewTimes, inputs_from_arguments, run_live

from .runs import Context

STAGES = ("capture", "wait", "2D", "fuse, track", "output", "send")
# people are looked for, and every camera's first region is found
SETTLED_S = 1.0
_DATAGRAM_BYTES = 65_535
_LISTEN_S = 0.2


@dataclass(frozen=True, eq=False)
class LiveTimes:
    """Views that went all the way through a live session.

    Attributes:
        cameras: names. camera: (n,) place in `cameras`.
        passed_s: (n, S + 1) when the view was exposed and when each of `STAGES` was over, seconds of the session.
        used_share: of the frames the cameras gave. output_hz: poses per second.
    """

    cameras: tuple[str, ...]
    camera: Array
    passed_s: Array
    used_share: float
    output_hz: float

    @property
    def stages_ms(self) -> Array:
        """(n, S) time in each stage."""
        return np.asarray(1000 * np.diff(self.passed_s, axis=1))

    @property
    def total_ms(self) -> Array:
        """(n,) from exposure to another program."""
        return np.asarray(1000 * (self.passed_s[:, -1] - self.passed_s[:, 0]))


class Listener:
    """Another program's ears: takes the datagrams of an output and remembers when each came."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(_LISTEN_S)
        self._heard: list[tuple[int, bytes]] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="listener", daemon=True)

    @property
    def address(self) -> str:
        """``host:port`` to send to."""
        host, port = self._socket.getsockname()
        return f"{host}:{port}"

    def __enter__(self) -> Listener:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()

    def arrivals_ns(self) -> dict[int, int]:
        """Time of a pose to when its first datagram came, monotonic ns."""
        found: dict[int, int] = {}
        for came_ns, datagram in self._heard:
            found.setdefault(int(json.loads(datagram)["t_ns"]), came_ns)
        return found

    def _listen(self) -> None:
        # read later: taking a datagram apart would hold up the loop whose times are taken
        while not self._over.is_set():
            try:
                datagram = self._socket.recv(_DATAGRAM_BYTES)
            except TimeoutError:
                continue
            self._heard.append((time.monotonic_ns(), datagram))


def live_times(folder: Path, context: Context, duration_s: float, loop_s: float | None = None) -> LiveTimes:
    """Play a session live for a while and follow every view from its exposure to another program.

    It is played again and again, every `loop_s`; None plays it once.

    Raises:
        SourceError: no view got through.
    """
    rig, config = read_rig(folder / "rig.toml"), context.config
    settings = LiveConfig(detector=config.detector, associate=config.associate, fuse=config.fuse)
    with Listener() as listener:
        plan = OutputPlan(rig=rig, clock=SessionClock.begin(), configs={"json": JsonConfig(to=(listener.address,))})
        inputs = tuple(replace(entry, loop_s=loop_s) for entry in inputs_from_arguments([f"sim:{folder}"], rig))
        done = run_live(rig, inputs, settings, plan, duration_s, context.console.note)
    offset_ns = plan.clock.offset_ns
    arrivals = {t_ns: came_ns + offset_ns for t_ns, came_ns in listener.arrivals_ns().items()}
    ways = list(done.fusion.latencies.newest)
    camera, passed_s = passages(ways, arrivals, rig.names, done.zero_ns)
    captured = sum(source.captured for name in rig.names if (source := done.fusion.monitor.source(name)))
    used_share = sum(done.fusion.used.values()) / max(captured, 1)
    settled = passed_s[:, 0] >= SETTLED_S
    if not settled.any():
        raise SourceError(f"{folder}: played live for {duration_s:g} s, and no view of {captured} led to a pose that went out")
    return LiveTimes(rig.names, camera[settled], passed_s[settled], used_share, done.fusion.latencies.rate_hz)


def passages(
    ways: list[tuple[ViewTimes, int]], arrivals: Mapping[int, int], cameras: tuple[str, ...], zero_ns: int
) -> tuple[Array, Array]:
    """Camera (n,) and passages (n, S + 1) in seconds, as `LiveTimes` has them, of the views whose pose arrived.

    Args:
        ways: views, and when the first pose that rests on each went out, session ns.
        arrivals: time of a pose to when it came, session ns.
        cameras: names. zero_ns: session time of 0 s.
    """
    pose_t_ns = np.array(sorted(arrivals), np.int64)
    camera, rows = [], []
    for way, output_ns in ways:
        # a pose goes out at the time it is for, or a little later
        place = int(np.searchsorted(pose_t_ns, output_ns, side="right")) - 1
        if place < 0 or arrivals[int(pose_t_ns[place])] < output_ns:
            continue
        camera.append(cameras.index(way.camera))
        rows.append((way.exposed_ns, way.received_ns, way.started_ns, way.detected_ns, way.fused_ns, output_ns,
                     arrivals[int(pose_t_ns[place])]))  # fmt: skip
    passed_ns = np.array(rows, np.int64).reshape(-1, len(STAGES) + 1)
    return np.array(camera, np.int64), (passed_ns - zero_ns) / 1e9
