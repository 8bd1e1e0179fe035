"""Which cameras are wrong about which keypoints of a person: the newest views of all cameras, fused robustly, judge each of them.

A filter that takes one view after the other believes what it believed before. Should it have begun with a wrong view, such as a
hand that a network invents behind a screen, the right ones lie beyond its gate. Robust fusion of one moment has no such memory.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.core import Detections2D, Pose3D, Rig, Skeleton
from posefuse.core.arrays import Array

from .contract import Solve
from .person import Person

_NEWEST_NS = 150_000_000
# two views never tell which of them is wrong
_LEAST_CAMERAS = 3
# a view is wrong about a keypoint that it places so far from the others: standard deviations, and metres at the body
_WRONG_SIGMAS, _WRONG_M = 5.0, 0.06
# a keypoint that is tracked so far from where the newest views put it begins there again
_ELSEWHERE_M = 0.12
_SAME_PERSON_M = 0.3
# a view is exchanged as a whole where that brings it so much closer
_CLEARLY = 0.5


class CrossCheck:
    """The newest views of one person. `checked_ns`: when they were last judged."""

    def __init__(self, rig: Rig, skeleton: Skeleton, solve: Solve) -> None:
        self._rig, self._skeleton, self._solve = rig, skeleton, solve
        self._mirror = np.asarray(skeleton.mirror)
        self._focal_px = np.array([camera.K[0, 0] for camera in rig])
        self._centres = np.stack([camera.centre_world for camera in rig])
        self._newest: dict[str, Detections2D] = {}
        self._wrong: dict[str, Array] = {}
        # (K,) keypoints that the check before found elsewhere
        self._far = np.zeros(len(skeleton), bool)
        self.checked_ns = 0

    def keep(self, view: Detections2D) -> Array:
        """Remember a view of the person alone; (K,) whether its camera is wrong about each keypoint, as far as is known."""
        before = self._newest.get(view.camera)
        if before is None or before.t_ns < view.t_ns:
            self._newest[view.camera] = view
        known = self._wrong.get(view.camera)
        return np.zeros(len(view.skeleton), bool) if known is None else known

    def check(self, person: Person, t_ns: int) -> None:
        """Judge all cameras by their newest views."""
        self.checked_ns = t_ns
        fresh = {name: view for name, view in self._newest.items() if abs(t_ns - view.t_ns) <= _NEWEST_NS}
        if len(fresh) < _LEAST_CAMERAS:
            self._wrong.clear()
            return
        now = person.expected(t_ns)[0]
        moved = [self._at(fresh[name], person, t_ns, now) if name in fresh else None for name in self._rig.names]
        together = [
            Detections2D.empty(name, t_ns, self._skeleton) if view is None else view
            for name, view in zip(self._rig.names, moved, strict=True)
        ]
        pose = self._solve(together, None)
        self._wrong, elsewhere = self._judged(pose, now, together)
        if np.isfinite(elsewhere).any():
            person.begin_again(elsewhere)

    def _at(self, view: Detections2D, person: Person, t_ns: int, now: Array) -> Detections2D:
        """The view as it would be at t_ns, moved by what the person moved since."""
        camera = self._rig[view.camera]
        then = person.expected(view.t_ns)[0]
        shift = np.nan_to_num(camera.project(now) - camera.project(then))
        return replace(view, t_ns=t_ns, xy_img=view.xy_img + shift)

    def _judged(self, pose: Pose3D, now: Array, together: list[Detections2D]) -> tuple[dict[str, Array], Array]:
        """By camera (K,) whether it is wrong, and (K, 3) keypoints that are elsewhere; NaN where they are not."""
        near_m, found = min(((_median_apart_m(now, xyz), n) for n, xyz in enumerate(pose.xyz_world)), default=(np.inf, 0))
        if near_m > _SAME_PERSON_M:
            return {}, np.full(now.shape, np.nan)
        xyz = pose.xyz_world[found]
        xyz = np.where(_exchanged(now, xyz, self._mirror)[:, None], xyz[self._mirror], xyz)
        wrong = {}
        for camera, centre, focal_px, view in zip(self._rig, self._centres, self._focal_px, together, strict=True):
            if not len(view):
                continue
            # a view with left and right exchanged as a whole is put right by the filter
            expected, depth_m = camera.project(xyz), _apart(xyz, centre)
            other = expected[self._mirror]
            turned = np.nansum(_apart(view.xy_img[0], other)) < _CLEARLY * np.nansum(_apart(view.xy_img[0], expected))
            away_px = _apart(view.xy_img[0], other if turned else expected)
            wrong[camera.name] = (away_px > _WRONG_SIGMAS * view.sigma_px[0]) & (away_px * depth_m > _WRONG_M * focal_px)
        far = _apart(xyz, now) > _ELSEWHERE_M
        again = far & self._far
        self._far = far & ~again
        return wrong, np.where(again[:, None], xyz, np.nan)


def _apart(one: Array, other: Array) -> Array:
    """(K,) distances."""
    return np.asarray(np.linalg.norm(one - other, axis=-1))


def _median_apart_m(one: Array, other: Array) -> float:
    distances = _apart(one, other)
    known = distances[np.isfinite(distances)]
    return float(np.median(known)) if len(known) else np.inf


def _exchanged(now: Array, points: Array, mirror: Array) -> Array:
    """(K,) which points lie closer to those of now with left and right exchanged; which side is which is not judged here."""
    same, other = _apart(points, now), _apart(points[mirror], now)
    return np.asarray(other + other[mirror] < same + same[mirror])
