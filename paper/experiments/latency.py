"""Time per stage and end to end of a live session (the paper's latency experiment); recorded: `bench/pipeline.py`."""

from __future__ import annotations

import itertools
import json
import re
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from paper.scenes import paper
from paper.scenes.scenes import walking_scene
from posefuse.core import Array, SourceError
from posefuse.formats import read_rig
from posefuse.formats.page import Block, Heading, Note, Plot, Plots, Spikes, Table
from posefuse.foundation import usable_cores
from posefuse.outputs.live import JsonConfig
from posefuse.realtime import LiveConfig, LivePlan, ViewTimes, inputs_from_arguments, run_live
from posefuse.sources import VideoConfig
from posefuse_sim import Scene, SessionPaths
from tools.page_marks import processor

from .runs import Context, Outcome, is_rendered, rendered

_QUICK_S, _FULL_S = 2.0, 60.0
# on a busy machine seconds pass before the first pose goes out
_QUICK_LIVE_S, _LIVE_S = 8.0, 20.0
_DECODED = 60
_SPIKES_S = 1.0
# of the program that names graphics cards
_NAMED_S = 20.0


def run(context: Context) -> Outcome:
    """The walking session, live at the pace of the clock, on each processor."""
    scene = _scene(context)
    folder = rendered("walking-1", scene, context)
    seconds = _QUICK_LIVE_S if context.quick else _LIVE_S
    found: dict[str, Mapping[str, Any]] = {}
    blocks: list[Block] = []
    for device, one in context.each_device().items():
        live = live_times(folder, one, seconds, scene.duration_s)
        alone_ms = {name: decode_ms(SessionPaths(folder).video(name)) for name in live.cameras}
        found[device] = {"processor": processor_of(device), **live_figures(live, alone_ms)}
        about = (
            "One spike per view, at its exposure and as high as its latency, its stages on top of each other; one second in the "
            "middle."
        )
        blocks += [Heading(f"Live, {device}: spikes over time", about), Plots(spike_plots(live))]
    return Outcome("Latency", {"live": found}, blocks)


def _scene(context: Context) -> Scene:
    """What is played; all of the walk only where another experiment has rendered it."""
    walk = walking_scene(1, _FULL_S)
    if not context.quick and is_rendered("walking-1", walk, context):
        return walk
    return walking_scene(1, _QUICK_S if context.quick else _LIVE_S)


def processor_of(device: str) -> str:
    """What a device is, for people: the graphics card by NVIDIA's own program, else the CPU of this machine."""
    card = re.fullmatch(r"(?:cuda|tensorrt)(?::(\d+))?", device)
    query = ["nvidia-smi", "--query-gpu=name", "--format=csv,noheader", f"--id={card[1] or 0}"] if card else []
    if not query or shutil.which(query[0]) is None:
        return f"{processor()}, {usable_cores()} cores"
    return subprocess.run(query, capture_output=True, text=True, timeout=_NAMED_S, check=False).stdout.strip() or device


def decode_ms(video: Path) -> float:
    """Mean time per image of decoding the first images of a video, with nothing else to do."""
    frames = VideoConfig(video, video.stem, threads=False).build().frames()
    began_s = time.perf_counter()
    count = sum(1 for frame in itertools.islice(frames, _DECODED) if frame.image.size)
    return 1000 * (time.perf_counter() - began_s) / max(count, 1)


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
        inputs = tuple(replace(entry, loop_s=loop_s) for entry in inputs_from_arguments([f"sim:{folder}"], rig))
        outputs = {"json": JsonConfig(to=(listener.address,))}
        plan = LivePlan(rig=rig, inputs=inputs, config=settings, outputs=outputs, duration_s=duration_s)
        done = run_live(plan, context.console.note)
    offset_ns = done.fusion.clock.offset_ns
    arrivals = {t_ns: came_ns + offset_ns for t_ns, came_ns in listener.arrivals_ns().items()}
    ways = list(done.fusion.latencies.newest)
    camera, passed_s = passages(ways, arrivals, rig.names, done.zero_ns)
    captured = sum(done.fusion.monitor.source(name).captured for name in rig.names)
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


def live_figures(live: LiveTimes, alone_ms: Mapping[str, float]) -> dict[str, Any]:
    """Times per camera and stage.

    Args:
        live: a session. alone_ms: per camera, decoding one image with nothing else to do.
    """
    stages, total = live.stages_ms, live.total_ms
    cameras = {}
    for c, name in enumerate(live.cameras):
        own = live.camera == c
        if own.any():
            cameras[name] = {
                "views": int(own.sum()),
                "decode_alone_ms": alone_ms[name],
                "stages_ms": {stage: spread(stages[own, s]) for s, stage in enumerate(STAGES)},
                "total_ms": spread(total[own]),
            }
    together = {stage: spread(stages[:, s]) for s, stage in enumerate(STAGES)} | {"total": spread(total)}
    return {"used_share": live.used_share, "output_hz": live.output_hz, "all_cameras_ms": together, "cameras": cameras}


def report(figures: Mapping[str, Any]) -> list[Block]:
    """Averages per camera and stage, and the processors next to those of the paper."""
    blocks: list[Block] = [
        Heading("Latency, four cameras"),
        Note(
            "Live, from mid-exposure to another program: mean ms per camera. capture: until the decoded image is in its process; "
            "wait: for the detector; output: until the next output tick of 100 Hz; send: by UDP."
        ),
    ]
    devices: list[list[Any]] = []
    for device, live in figures["live"].items():
        rows = [
            [name, *(one["stages_ms"][stage]["mean"] for stage in STAGES), one["total_ms"]["mean"], one["total_ms"]["p95"],
             one["decode_alone_ms"]]
            for name, one in live["cameras"].items()
        ]  # fmt: skip
        blocks += [
            Note(f"Device: {device} ({live['processor']}):"),
            Table(["camera", *STAGES, "end to end", "p95", "decoding alone"], rows),
            Note(f"{100 * live['used_share']:.0f} % of the frames used, {live['output_hz']:.1f} poses per second."),
        ]
        ms = live["all_cameras_ms"]
        means = [ms[stage]["mean"] for stage in ("2D", "fuse, track", "total")]
        devices.append([device, live["processor"], *means, ms["total"]["p95"], 100 * live["used_share"]])
    devices += [
        ["paper", f"the {which} of three GPUs", ms, paper.TRIANGULATE_MS, None, None, None]
        for which, ms in zip(("fastest", "slowest"), paper.DETECT_MS, strict=True)
    ]
    columns = ["device", "processor", "2D", "fuse, track", "end to end", "p95", "% of frames used"]
    by_processor = "By processor, next to the paper's 2D per frame and triangulation on GPUs, mean ms of all cameras:"
    return [*blocks, Note(by_processor), Table(columns, devices)]


def spike_plots(live: LiveTimes) -> list[Plot]:
    """Of every camera a second in the middle."""
    middle_s = float(np.median(live.passed_s[:, 0]))
    near = np.abs(live.passed_s[:, 0] - middle_s) <= _SPIKES_S / 2
    window = (middle_s - _SPIKES_S / 2, middle_s + _SPIKES_S / 2, 0.0, 1.05 * float(live.total_ms[near].max()))
    return [
        Plot(name, view_spikes(live, c, middle_s), x_label="s", y_label="ms", window=window)
        for c, name in enumerate(live.cameras)
    ]


def view_spikes(live: LiveTimes, camera: int, middle_s: float) -> list[Spikes]:
    """Per stage, its part of every spike of a camera within a second."""
    near = (live.camera == camera) & (np.abs(live.passed_s[:, 0] - middle_s) <= _SPIKES_S / 2)
    passed_s = live.passed_s[near]
    late_ms = 1000 * (passed_s - passed_s[:, :1])
    return [Spikes(stage, passed_s[:, 0], late_ms[:, s], late_ms[:, s + 1]) for s, stage in enumerate(STAGES)]


def spread(ms: Array) -> dict[str, float]:
    """Median, mean, 95th percentile and most."""
    return {
        "median": float(np.median(ms)),
        "mean": float(ms.mean()),
        "p95": float(np.percentile(ms, 95)),
        "most": float(ms.max()),
    }
