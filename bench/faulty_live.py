"""`posefuse` with camera faults on purpose, to see that a session survives them.

    python bench/faulty_live.py [--fault CAMERA=KIND@START[-END]]... [--zero UNIX_S] -- live RIG --source sim:SESSION

Kinds: freeze (the same image again and again), jump (the camera's clock is an hour ahead), skew (50 ms ahead), bump (the camera
is turned by 1.5 degrees), flood (forty frames for one), hang (sends nothing), unplug (the source ends, and comes back). START and
END are seconds after the beginning of the source. `--zero`: recorded and simulated sources of this node begin then. The oracle
knows neither images nor times that a video does not have: jump, skew and bump need a network. It prints and
writes what `posefuse live` does.
"""

import argparse
import re
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posefuse.core import SE3, Camera, Frame, SourceError
from posefuse.realtime.capture import LOOP_PAUSE_S, LiveInput

FAULTS = ("freeze", "jump", "skew", "bump", "flood", "hang", "unplug")
# about the vertical, to the right, and about the optical axis: as a camera is turned that a person brushes past
_BUMP_RAD = np.deg2rad([0.3, 1.4, 0.3])
_OFF_NS = {"jump": 3600 * 1_000_000_000, "skew": 50_000_000}
_COPIES = 40
_FAR_M = 100.0
_POLL_S = 0.02


@dataclass(frozen=True)
class Fault:
    """What goes wrong with a camera, and from when to when."""

    kind: str
    start_s: float
    end_s: float


@dataclass(frozen=True)
class FaultyConfig:
    """A source with faults, shown again and again if its input is looped; for a camera of the rig."""

    entry: LiveInput
    camera: Camera
    faults: tuple[Fault, ...]
    zero_ns: int | None = None

    def build(self) -> "FaultySource":
        return FaultySource(self)


class FaultySource:
    """Its frames."""

    def __init__(self, config: FaultyConfig) -> None:
        self._config, self._source = config, config.entry.open(None, config.zero_ns)
        self.camera, self.size_wh = config.camera.name, self._source.size_wh
        self._map: Any = None

    def frames(self) -> Iterator[Frame]:
        begun_s = (self._config.zero_ns or time.monotonic_ns()) / 1e9
        last = None
        for frame in self._looped():
            now_s = time.monotonic() - begun_s
            active = {fault.kind: fault for fault in self._config.faults if fault.start_s <= now_s < fault.end_s}
            if "unplug" in active:
                raise SourceError(f"camera {self.camera}: unplugged on purpose")
            while "hang" in active and time.monotonic() - begun_s < active["hang"].end_s:
                time.sleep(_POLL_S)
            if "freeze" not in active or last is None:
                last = self._turned(frame) if "bump" in active else frame
            off_ns = sum(_OFF_NS.get(kind, 0) for kind in active)
            for copy in range(_COPIES if "flood" in active else 1):
                yield replace(frame, image=last.pixels, t_ns=frame.t_ns + off_ns + copy)

    def close(self) -> None:
        self._source.close()

    def _looped(self) -> Iterator[Frame]:
        entry, zero_ns = self._config.entry, self._config.zero_ns
        if not entry.loop_s or zero_ns is None:
            yield from self._source.frames()
            return
        period_ns = round((entry.loop_s + LOOP_PAUSE_S) * 1e9)
        turn = max(0, (time.monotonic_ns() - zero_ns) // period_ns)
        while True:
            self._source = entry.open(None, zero_ns + turn * period_ns)
            for frame in self._source.frames():
                if frame.t_ns < round(entry.loop_s * 1e9):
                    later_ns = turn * period_ns
                    yield replace(frame, image=frame.pixels, t_ns=frame.t_ns + later_ns, received_ns=frame.received_ns + later_ns)
            turn += 1

    def _turned(self, frame: Frame) -> Frame:
        """The image of the camera after it was turned."""
        camera = self._config.camera
        if self._map is None:
            turned = replace(camera, cam_from_world=SE3.from_rotvec(_BUMP_RAD, np.zeros(3)) @ camera.cam_from_world)
            grid = np.stack(np.meshgrid(*map(np.arange, self.size_wh)), axis=-1).astype(float)
            self._map = camera.project(camera.centre_world + _FAR_M * turned.rays_world(grid)).astype(np.float32)
        return replace(frame, image=cv2.remap(frame.image, self._map, None, cv2.INTER_LINEAR))


def faults_from_arguments(arguments: list[str]) -> dict[str, tuple[Fault, ...]]:
    """Faults by camera."""
    found: dict[str, tuple[Fault, ...]] = {}
    for argument in arguments:
        match = re.fullmatch(r"([^=]+)=([a-z]+)@([0-9.]+)(?:-([0-9.]+))?", argument)
        if not match or match[2] not in FAULTS:
            raise SystemExit(f"--fault {argument}: expected CAMERA=KIND@START[-END], kinds: {', '.join(FAULTS)}")
        fault = Fault(match[2], float(match[3]), float(match[4] or "inf"))
        found[match[1]] = (*found.get(match[1], ()), fault)
    return found


def main() -> int:
    """Run the command line on faulty sources."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fault", action="append", default=[])
    parser.add_argument("--zero", type=float)
    parser.add_argument("command", nargs="+")
    args = parser.parse_args()
    faults = faults_from_arguments(args.fault)

    from posefuse.api import live_run
    from posefuse.cli.main import main as posefuse
    from posefuse.realtime.messages import SessionClock
    from posefuse.realtime.processes import Groups

    sources, begin = live_run.inputs_from_arguments, Groups.begin

    def faulty_inputs(*options: Any) -> tuple[LiveInput, ...]:
        rig = options[1]
        return tuple(
            LiveInput(one.camera, one.kind, FaultyConfig(one, rig[one.camera], faults[one.camera]), reopen=True)
            if one.camera in faults else one
            for one in sources(*options)
        )  # fmt: skip

    live_run.inputs_from_arguments = faulty_inputs
    if args.zero is not None:
        Groups.begin = lambda groups, _: begin(groups, round(args.zero * 1e9) - SessionClock.begin().offset_ns)
    return posefuse(args.command)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent))
    # camera processes know the classes by the name of the module
    from faulty_live import main as run

    sys.exit(run())
