"""A person of 17 points who moves as wanted, seen by cameras that do not wait for each other."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from built import detections, standing

from posefuse.association import AssociateSettings, associate
from posefuse.core import Detections2D, Pose3D, Rig, Views
from posefuse.core.skeleton import COCO17
from posefuse.fusion import FuseSettings, fuse, whitened_view
from posefuse.tracking.online import LiveMotion, LiveSettings, Model, Tracker

SIGMA_PX = 2.0


@dataclass(frozen=True)
class World:
    """Cameras, and where the 17 points are at a time in seconds."""

    rig: Rig
    place: Callable[[float], np.ndarray]

    def view(self, c: int, t_s: float, rng: np.random.Generator | None = None, sigma_px: float = SIGMA_PX) -> Detections2D:
        """What camera number c sees; exact without `rng`."""
        xy = seen(self.rig, c, self.place(t_s), rng, sigma_px)
        return detections_at(self.rig.cameras[c].name, t_s, xy, sigma_px=sigma_px)

    def views(self, seconds: float, seed: int | None = 0, rate_hz: float = 30.0, start_s: float = 0.0) -> list[Detections2D]:
        """Every camera's views in the order of their own times, phases apart; exact when seed is None."""
        rng = None if seed is None else np.random.default_rng(seed)
        frames, cameras = range(int(seconds * rate_hz)), range(len(self.rig))
        times = [(start_s + (i + c / len(self.rig)) / rate_hz, c) for i in frames for c in cameras]
        return [self.view(c, t_s, rng) for t_s, c in sorted(times)]

    def tracker(self, **settings: object) -> Tracker:
        """With association and fusion of one time step as `app` has them."""
        of_motion = {name: settings.pop(name) for name in set(settings) & {one.name for one in fields(LiveMotion)}}
        live, motion = LiveSettings(**settings), LiveMotion(**of_motion)
        people = AssociateSettings(max_people=live.max_people)

        def solve(together: Sequence[Detections2D]) -> Pose3D:
            return fuse(associate(together, self.rig, people), self.rig, FuseSettings())

        return Tracker(Model(self.rig, COCO17, live, motion), solve, self.fuse, self.whitened)

    def fed(self, views: Iterable[Detections2D], **settings: object) -> Tracker:
        """A tracker that was given these views."""
        tracker = self.tracker(**settings)
        for view in views:
            tracker.add(view)
        return tracker

    def fuse(self, views: Views) -> Pose3D:
        """Fusion of one time step as `app` has it."""
        return fuse(views, self.rig, FuseSettings())

    def whitened(self, view: Detections2D) -> tuple[np.ndarray, ...]:
        """A view without its lens as `app` has it."""
        return whitened_view(view, self.rig.only([view.camera]), FuseSettings())

    def error_m(self, pose: Pose3D, person: int = 0) -> np.ndarray:
        """(K,) distances from the truth at the pose's time."""
        return np.linalg.norm(pose.xyz_world[person] - self.place(pose.t_ns / 1e9), axis=-1)


def seen(rig: Rig, c: int, xyz: np.ndarray, rng: np.random.Generator | None, sigma_px: float = SIGMA_PX) -> np.ndarray:
    """(K, 2) px of points in a camera, with noise."""
    xy = rig.cameras[c].project(xyz)
    return xy if rng is None else xy + rng.normal(0, sigma_px, xy.shape)


def detections_at(camera: str, t_s: float, *people_xy: np.ndarray, sigma_px: float = SIGMA_PX) -> Detections2D:
    """Several people in one view at a time in seconds."""
    return detections(camera, np.array(people_xy), round(t_s * 1e9), sigma_px=sigma_px)


def _walk(t_s: float) -> np.ndarray:
    """Ahead at 1.2 m/s from one side of the ring to the other, arms and legs swinging."""
    xyz = standing()
    for name, reach_m, sign in (("wrist", 0.25, 1), ("elbow", 0.12, 1), ("knee", 0.12, -1), ("ankle", 0.25, -1)):
        for side in (1, -1):
            swing = sign * side * reach_m * np.sin(2 * np.pi * 0.9 * t_s)
            xyz[COCO17.index(("left_" if side > 0 else "right_") + name), 0] += swing
    return xyz + (1.2 * t_s - 1.5, 0.0, 0.0)


@pytest.fixture(scope="session")
def world(ring_rig: Callable[..., Rig]) -> Callable[..., World]:
    """Builder: cameras (default 4), motion ``walk``, ``stand`` or a function of time."""

    def build(cameras: int = 4, motion: str | Callable[[float], np.ndarray] = "walk", **rig: object) -> World:
        motions = {"walk": _walk, "stand": lambda t_s: standing()}
        return World(ring_rig(cameras, **rig), motions[motion] if isinstance(motion, str) else motion)

    return build


@pytest.fixture(scope="session")
def detections_of() -> Callable[..., Detections2D]:
    """(camera, t_s, *people_xy) -> Detections2D."""
    return detections_at


@pytest.fixture(scope="session")
def sides_swapped() -> Callable[[Detections2D], Detections2D]:
    """The same view with left and right swapped."""
    turn = COCO17.mirror
    return lambda view: replace(view, xy_img=view.xy_img[:, turn], score=view.score[:, turn], sigma_px=view.sigma_px[:, turn])
