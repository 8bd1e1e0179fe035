"""Corners of a waved prop as cameras would see them, with the exact truth: calibration tried without cameras or images."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import BOARD_PATCH, Target
from posefuse.core import SE3, Rig
from posefuse.core.arrays import Array

_STEEPEST_VIEW_COSINE = 0.3
_SMALLEST_EDGE_PX = 10.0


@dataclass(frozen=True)
class Waving:
    """How a prop is moved: a smooth, reproducible mixture of swings about a centre.

    Attributes:
        seconds, rate_hz: length and frame rate of the recording.
        centre_m, reach_m: middle and half size of the volume it moves through.
        swings_hz: the quickest swing.
        seed: which movement.
    """

    seconds: float = 60.0
    rate_hz: float = 30.0
    centre_m: tuple[float, float, float] = (0.0, 0.0, 1.1)
    reach_m: tuple[float, float, float] = (1.2, 1.0, 0.6)
    swings_hz: float = 0.45
    seed: int = 0

    def pose(self, t_s: Array) -> SE3:
        """world_from_prop at times (T,)."""
        random = np.random.default_rng(self.seed)
        rates = 2 * np.pi * random.uniform(0.1, 1.0, (6, 4)) * self.swings_hz
        phases = random.uniform(0, 2 * np.pi, (6, 4))
        swings = np.sin(rates[:, :, None] * t_s + phases[:, :, None]).sum(axis=1).T / 2.2
        xyz = np.array(self.centre_m) + swings[:, :3] * np.array(self.reach_m)
        return SE3.from_rotvec(2.4 * swings[:, 3:], xyz)


@dataclass(frozen=True)
class Faults:
    """What cameras and detection do wrong.

    Attributes:
        noise_px: standard deviation of a corner coordinate. missed: share of patches not found.
        delay_s, drift: per camera, how late and how much faster its clock runs.
        seed: of the noise.
    """

    noise_px: float = 0.25
    missed: float = 0.05
    delay_s: tuple[float, ...] = ()
    drift: tuple[float, ...] = ()
    seed: int = 0


def cube(side_m: float, first_id: int = 0) -> dict[int, SE3]:
    """prop_from_marker of six markers in the middle of the faces of a cube of edge `side_m`."""
    turns = [[0, 0, 0], [np.pi / 2, 0, 0], [-np.pi / 2, 0, 0], [0, np.pi / 2, 0], [0, -np.pi / 2, 0], [np.pi, 0, 0]]
    poses = {}
    for i, turn in enumerate(turns):
        facing = SE3.from_rotvec(np.array(turn), np.zeros(3))
        poses[first_id + i] = facing @ SE3(np.array([1.0, 0, 0, 0]), np.array([0, 0, side_m / 2]))
    return poses


def board() -> dict[int, SE3]:
    """A flat board: its one patch is the prop."""
    return {BOARD_PATCH: SE3.identity()}


def observe_prop(rig: Rig, prop: Mapping[int, SE3], target: Target, motion: Waving, faults: Faults) -> CornerObservations:
    """What the cameras of `rig` see of the prop; frames of camera c are stamped late by its delay and drift."""
    random = np.random.default_rng(faults.seed)
    stamps_s = np.arange(round(motion.seconds * motion.rate_hz)) / motion.rate_hz
    delay = np.array(faults.delay_s or [0.0] * len(rig))
    drift = np.array(faults.drift or [0.0] * len(rig))
    rows: list[tuple[Array, ...]] = []
    for c, camera in enumerate(rig):
        true_s = stamps_s - delay[c] - drift[c] * (stamps_s - motion.seconds / 2)
        world_from_prop = motion.pose(true_s)
        for patch, prop_from_patch in prop.items():
            world_from_patch = world_from_prop @ SE3(
                np.broadcast_to(prop_from_patch.wxyz, (len(true_s), 4)), np.broadcast_to(prop_from_patch.xyz, (len(true_s), 3))
            )
            corners = target.corners(patch)
            xyz = np.stack([world_from_patch @ np.tile(corner, (len(true_s), 1)) for corner in corners], axis=1)
            xy = camera.project(xyz)
            to_camera = camera.centre_world - xyz.mean(axis=1)
            normal = world_from_patch.matrix()[:, :, 2]
            cosine = (normal * to_camera).sum(axis=1) / np.linalg.norm(to_camera, axis=1)
            with np.errstate(invalid="ignore"):
                inside = ((xy > 3) & (xy < np.array(camera.size_wh) - 4)).all(axis=(1, 2))
                big = np.linalg.norm(xy[:, 0] - xy[:, -1], axis=1) > _SMALLEST_EDGE_PX
            found = inside & big & (cosine > _STEEPEST_VIEW_COSINE) & (random.random(len(true_s)) > faults.missed)
            frames, n = np.flatnonzero(found), len(corners)
            noisy = xy[frames] + random.normal(0, faults.noise_px, (len(frames), n, 2))
            rows.append(
                (
                    np.full(len(frames) * n, c), np.repeat(np.round(stamps_s[frames] * 1e9).astype(np.int64), n),
                    np.full(len(frames) * n, patch), np.tile(np.arange(n), len(frames)), noisy.reshape(-1, 2),
                )
            )  # fmt: skip
    camera_no, t_ns, patch_no, corner_no, xy_img = (np.concatenate([row[i] for row in rows]) for i in range(5))
    return CornerObservations(
        cameras=rig.names,
        sizes_wh=tuple(camera.size_wh for camera in rig),
        frame_count=(len(stamps_s),) * len(rig),
        camera=camera_no,
        t_ns=t_ns,
        patch=patch_no,
        corner=corner_no,
        xy_img=xy_img,
    )
