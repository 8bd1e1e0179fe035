"""Sessions with a prop or a board as cameras would have seen them, by seed, and what the calibration answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.extrinsics.pipeline import Options
from posefuse.calibration.extrinsics.self_checks import camera_differences
from posefuse.calibration.extrinsics.target import calibrate_extrinsics
from posefuse.calibration.extrinsics.world import triangulate_linear
from posefuse.calibration.geometry import Poses, nearest_rotation, stacked
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Charuco, Markers, Target
from posefuse.core import SE3, CalibrationError, Camera, Rig
from posefuse.core.arrays import Array
from posefuse_sim.cameras import looking_at

from .verdict import Answer
from .waved_props import Faults, Waving, board, cube, observe_prop

TIME_STEPS = 120
_ROWS = ("camera", "t_ns", "patch", "corner", "xy_img")


@dataclass(frozen=True, eq=False)
class Session:
    """A rig that is known, and a target that is waved in it."""

    rig: Rig
    target: Target
    prop: Mapping[int, SE3]
    motion: Waving
    faults: Faults

    def watch(self, rig: Rig | None = None, motion: Waving | None = None, **faults: object) -> CornerObservations:
        """What the cameras see, with some things changed."""
        return observe_prop(
            rig or self.rig,
            self.prop,
            self.target,
            motion or self.motion,
            replace(self.faults, **faults),
        )


def ring(count: int, seed: int, radius_m: float = 4.0, size_wh: tuple[int, int] = (640, 480), model: str = "pinhole") -> Rig:
    """Cameras round the middle, each with a lens of its own (focal lengths within 3 %, principal points within 8 px)."""
    random, cameras = np.random.default_rng([seed, 7]), []
    for i in range(count):
        angle = 2 * np.pi * i / count + random.uniform(-0.15, 0.15)
        radius = radius_m * random.uniform(0.92, 1.08)
        centre = np.array([radius * np.cos(angle), radius * np.sin(angle), random.uniform(1.9, 2.5)])
        focal = 0.9 * size_wh[0] * random.uniform(0.97, 1.03)
        cx, cy = np.array([size_wh[0] - 1, size_wh[1] - 1]) / 2 + random.uniform(-8, 8, 2)
        lens = np.array([-0.14, 0.06, 0, 0, 0]) * random.uniform(0.8, 1.2) + [0, 0, 5e-4, -5e-4, 0]
        if model == "fisheye":
            lens = np.array([0.03, -0.01, 0.002, 0.0])
        intrinsics = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])
        pose = looking_at(centre, np.array([0, 0, 1.0]))
        cameras.append(
            Camera(name=f"cam{i:02d}", size_wh=size_wh, K=intrinsics, cam_from_world=pose, distortion=lens, model=model)
        )
    return Rig(tuple(cameras), world_set_by="truth")


def prop_session(seed: int, count: int = 4) -> Session:
    """A box of markers, waved for 30 s."""
    motion = Waving(seconds=30.0, rate_hz=15.0, seed=seed)
    return Session(ring(count, seed), Markers(0.24), cube(0.3), motion, Faults(noise_px=0.25, seed=seed))


def board_session(seed: int, count: int = 4) -> Session:
    """A ChArUco board before cameras that stand on one side."""
    rig = ring(9, seed, radius_m=3.4)
    picked = Rig(tuple(replace(rig.cameras[i], name=f"cam{i:02d}") for i in range(count)), world_set_by="truth")
    motion = Waving(seconds=40.0, rate_hz=15.0, seed=seed, reach_m=(0.8, 0.8, 0.5))
    return Session(
        picked, Charuco(columns=5, rows=7, square_m=0.12, marker_m=0.09), board(), motion, Faults(noise_px=0.25, seed=seed)
    )


def solve(
    truth: Rig,
    observations: CornerObservations,
    cameras: tuple[Camera, ...],
    target: Target,
    options: Options | None = None,
) -> Answer:
    """Calibrate, and compare with the truth."""
    try:
        found = calibrate_extrinsics(observations, cameras, target, options or Options(time_steps=TIME_STEPS))
    except CalibrationError as error:
        return Answer(True, str(error))
    return Answer(False, "; ".join(found.report.notes), *errors(truth, found.rig))


def errors(truth: Rig, found: Rig) -> tuple[float, float]:
    """Worst camera in mm and degrees; where the world lies does not count."""
    true, ours = (stacked([Poses.from_se3(rig[name].cam_from_world) for name in found.names]) for rig in (truth, found))
    metres, radians = camera_differences(true, ours)
    return float(metres.max() * 1e3), float(np.rad2deg(radians.max()))


def merged(*parts: CornerObservations) -> CornerObservations:
    """CornerObservations of the same cameras put together."""
    return replace(parts[0], **{name: np.concatenate([getattr(part, name) for part in parts]) for name in _ROWS})


def of_camera(observations: CornerObservations, camera: int, xy_img: Array) -> CornerObservations:
    """With one camera's image points changed."""
    return replace(observations, xy_img=np.where((observations.camera == camera)[:, None], xy_img, observations.xy_img))


def switched(before: CornerObservations, after: CornerObservations, camera: int, at_s: float) -> CornerObservations:
    """One camera's views from `at_s` on out of other observations."""
    late = before.t_ns >= round(at_s * 1e9)
    return merged(
        before.rows((before.camera != camera) | ~late), after.rows((after.camera == camera) & (after.t_ns >= round(at_s * 1e9)))
    )


def restamped(observations: CornerObservations, camera: int, stamp_ns: Array) -> CornerObservations:
    """One camera's frames with other time stamps; `stamp_ns` (N,) for all rows."""
    return replace(observations, t_ns=np.where(observations.camera == camera, stamp_ns, observations.t_ns))


def moved(camera: Camera, shift_m: float, turn_deg: float, seed: int) -> Camera:
    """The camera shifted and turned about random axes."""
    random = np.random.default_rng([seed, 11])
    along, axis = (v / np.linalg.norm(v) for v in random.normal(0, 1, (2, 3)))
    there = SE3.from_rotvec(np.deg2rad(turn_deg) * axis, shift_m * along)
    return replace(camera, cam_from_world=there @ camera.cam_from_world)


def zoomed(camera: Camera, by: float) -> Camera:
    """Intrinsics with a focal length that is too large by a share."""
    return replace(camera, K=camera.K * np.array([[1 + by, 1, 1], [1, 1 + by, 1], [1, 1, 1]]))


def one_changed(cameras: tuple[Camera, ...], index: int, changed: Camera) -> tuple[Camera, ...]:
    """All cameras, one of them changed."""
    return (*cameras[:index], changed, *cameras[index + 1 :])


def scale_of(first: Poses, second: Poses) -> float:
    """How many times as large as the second set of cam_from_world the first is, by the cameras' centres in least squares."""
    a, b = first.inverse(), second.inverse()
    turn = nearest_rotation((a.R @ np.swapaxes(b.R, 1, 2)).sum(axis=0))
    moved = (b.t - b.t.mean(axis=0)) @ turn.T
    return float(((a.t - a.t.mean(axis=0)) * moved).sum() / (moved**2).sum())


def off_others_px(rig: Rig, xy_img: Array) -> Array:
    """(C, P, 2) px from what each camera saw (C, P, 2) to where the rays of the others meet; NaN with fewer than two others."""
    off = np.empty(xy_img.shape)
    for c, camera in enumerate(rig):
        mine = (np.arange(len(rig)) == c)[:, None, None]
        off[c] = camera.project(triangulate_linear(rig, np.where(mine, np.nan, xy_img))) - xy_img[c]
    return off
