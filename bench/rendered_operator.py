"""The operator of the box task as cameras see them: rendered, found by a network, tracked as live; in simulated time.

Views arrive a fixed time after their exposure, so that figures depend neither on the machine nor on its load.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from heapq import merge
from pathlib import Path

import numpy as np
from rehearsal.boxes import RATE_HZ, BoxStage

from posefuse.api.detector import detector
from posefuse.core import Detections2D, Frame, InputError, Rig
from posefuse.detection import region_from_pose
from posefuse.formats.rig import read_rig
from posefuse.foundation.settings import settings_from_mapping
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.realtime.messages import Centres
from posefuse.sources.video import VideoConfig
from posefuse_sim.scene import Scene, read_scene
from posefuse_sim.session import SessionPaths, simulate
from posefuse_teleop.hands import operator_view
from posefuse_teleop.values import OperatorView

# the tracker needs a moment to find the operator
BEGIN_S = 3.0
_S = 1e9


def scene_of_task(boxes: int, rate_hz: float, seed: int) -> Scene:
    """Four cameras that do not wait for each other, and an operator whose right hand does the task."""
    at_s, places = BoxStage.built(boxes).hand_path(BEGIN_S)
    path = [[float(t), *map(float, place)] for t, place in zip(at_s, places, strict=True)]
    ring = {
        "kind": "ring", "count": 4, "radius_m": 3.0, "height_m": 2.0, "look_at_m": [0.0, 0.0, 1.1], "first_angle_deg": 30.0,
        "image": {"size_px": [640, 480], "horizontal_fov_deg": 62.0},
        "overrides": {f"cam{c:02d}": {"sensor": {"phase_s": c / 4 / rate_hz}} for c in range(4)},
    }  # fmt: skip
    content = {
        "duration_s": float(at_s[-1]) + 0.3, "rate_hz": rate_hz, "seed": seed, "cameras": ring,
        "people": [{"motion": {"kind": "hand_path", "path": path}}],
    }  # fmt: skip
    return settings_from_mapping(content, Scene, "bench")


def rendered(folder: Path, boxes: int, rate_hz: float, seed: int, progress=None) -> SessionPaths:
    """The session of the task; one that was interrupted is continued, one that is finished is used as it is.

    Raises:
        InputError: the folder holds anything else, or the session of another task.
    """
    scene, paths = scene_of_task(boxes, rate_hz, seed), SessionPaths(folder)
    if not paths.truth.exists():
        return simulate(scene, folder, progress or (lambda done, total: None), None)
    if read_scene(paths.scene) != scene:
        raise InputError(f"{folder}: holds the session of another task; choose another folder")
    return paths


@dataclass(frozen=True)
class Arrived:
    """A frame and when what was found in it is known."""

    at_ns: int
    frame: Frame

    def __lt__(self, other: Arrived) -> bool:
        return self.at_ns < other.at_ns


class SeenHand:
    """The hand as the live tracker knows it at each tick (`boxes.Hand`).

    Attributes:
        rows: per tick with a hand: stated standard deviation m, and displacement of the hand from the true one, (3,).
    """

    def __init__(self, session: Path, networks: str, latency_s: float) -> None:
        self._rig: Rig = read_rig(SessionPaths(session).rig)
        finder = detector(networks)
        self._detector = finder._detector
        config = LiveConfig()
        self._estimator = warmed_up(self._rig, finder.skeleton, config)
        self._estimator.centring.learn(Centres(self._rig.names, self._detector.joint_centres))
        self._frames = _arrivals(SessionPaths(session).videos, self._rig, round(latency_s * _S))
        self._next = next(self._frames, None)
        self._measured_ns = 0
        self.rows: list[tuple[float, np.ndarray]] = []

    def view(self, k: int, hand_world: np.ndarray, now_ns: int) -> OperatorView | None:
        """See `boxes.Hand`."""
        t_ns = round(k / RATE_HZ * _S)
        while self._next is not None and self._next.at_ns <= t_ns:
            self._see(self._next.frame)
            self._next = next(self._frames, None)
        pose = self._estimator.at(t_ns)
        if not len(pose.person_id):
            return None
        shift_ns = now_ns - t_ns
        found = replace(operator_view(pose, ("right",), None, self._measured_ns + shift_ns), t_ns=now_ns)
        if np.isfinite(found.xyz_world).all():
            self.rows.append((float(found.sigma_m[0]), found.xyz_world[0] - hand_world))
        return found

    def _see(self, frame: Frame) -> None:
        camera = self._rig[frame.camera]
        expected = self._estimator.looked_for(frame.t_ns)
        known = np.isfinite(expected.xyz_world).all(axis=-1).any(axis=-1)
        looks = [region_from_pose(camera, xyz, expected.skeleton) for xyz in expected.xyz_world[known]]
        regions = [look for look in looks if look is not None] if len(looks) else None
        [found] = self._detector.detect([frame], [regions])
        self._estimator.add(_seen(found))
        self._measured_ns = max(self._measured_ns, frame.t_ns)


def _seen(found: Detections2D) -> Detections2D:
    return found.people(np.any(found.score > 0, axis=-1))


def _arrivals(videos: Path, rig: Rig, latency_ns: int) -> Iterator[Arrived]:
    def of(name: str) -> Iterator[Arrived]:
        for frame in VideoConfig(videos / f"{name}.mp4", name).build().frames():
            yield Arrived(frame.t_ns + latency_ns, frame)

    return merge(*(of(name) for name in rig.names))
