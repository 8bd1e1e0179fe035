"""The operator of the box task as cameras see them: rendered, found by a network, tracked as live; in simulated time.

Views arrive a fixed time after their exposure, so that figures depend neither on the machine nor on its load. For the step boxes
of `bench/teleoperation.py`; writes nothing but the rendered session.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from heapq import merge
from pathlib import Path

import numpy as np
from harness import rendered, scene_from
from rehearsal.boxes import BoxStage
from rehearsal.operator import RATE_HZ

from posefuse.api.values import detector
from posefuse.core import Frame, LiveJointCentres, Rig
from posefuse.detection import region_from_pose
from posefuse.formats.rig import read_rig
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.sources.video import VideoConfig
from posefuse_sim.session import SessionPaths
from posefuse_teleop.hands import operator_view
from posefuse_teleop.values import OperatorView

# the tracker needs a moment to find the operator
BEGIN_S = 3.0
_S = 1e9


def session_of_task(folder: Path, boxes: int, rate_hz: float, seed: int) -> Path:
    """Four cameras that do not wait for each other, and an operator whose right hand does the task; rendered in the folder."""
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
    return rendered(scene_from(content), folder / f"boxes{boxes}-{rate_hz:g}Hz-{seed}", processes=None)


class SeenHand:
    """The hand as the live tracker knows it at each tick (`operator.Hand`).

    Attributes:
        rows: per tick with a hand: stated standard deviation m, and displacement of the hand from the true one, (3,).
    """

    def __init__(self, session: Path, networks: str, latency_s: float) -> None:
        self._rig: Rig = read_rig(SessionPaths(session).rig)
        finder = detector(networks)
        self._detector = finder._detector
        self._estimator = warmed_up(self._rig, finder.skeleton, LiveConfig())
        self._estimator.centring.learn(LiveJointCentres(t_ns=0, cameras=self._rig.names, table=self._detector.joint_centres))
        self._frames, self._late_ns = _frames(SessionPaths(session).videos, self._rig), round(latency_s * _S)
        self._next = next(self._frames, None)
        self._measured_ns = 0
        self.rows: list[tuple[float, np.ndarray]] = []

    def view(self, k: int, hand_world: np.ndarray, now_ns: int) -> OperatorView | None:
        """See `operator.Hand`."""
        t_ns = round(k / RATE_HZ * _S)
        while self._next is not None and self._next.t_ns + self._late_ns <= t_ns:
            self._see(self._next)
            self._next = next(self._frames, None)
        pose = self._estimator.at(t_ns)
        if not len(pose.person_id):
            return None
        found = operator_view(pose, ("right",), None, self._measured_ns + now_ns - t_ns)
        if np.isfinite(found.xyz_world).all():
            self.rows.append((float(found.sigma_m[0]), found.xyz_world[0] - hand_world))
        return replace(found, t_ns=now_ns)

    def _see(self, frame: Frame) -> None:
        camera, expected = self._rig[frame.camera], self._estimator.looked_for(frame.t_ns)
        known = np.isfinite(expected.xyz_world).all(axis=-1).any(axis=-1)
        looks = [region_from_pose(camera, xyz, expected.skeleton) for xyz in expected.xyz_world[known]]
        [found] = self._detector.detect([frame], [[look for look in looks if look is not None] if looks else None])
        self._estimator.add(found.people(np.any(found.score > 0, axis=-1)))
        self._measured_ns = max(self._measured_ns, frame.t_ns)


def _frames(videos: Path, rig: Rig) -> Iterator[Frame]:
    """Of all cameras, in the order of time."""
    return merge(*(VideoConfig(videos / f"{name}.mp4", name).build().frames() for name in rig.names), key=lambda one: one.t_ns)
