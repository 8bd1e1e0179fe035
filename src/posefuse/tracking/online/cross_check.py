"""Which cameras are wrong about which keypoints of a person: the newest views of all cameras, fused robustly, judge each of them.

A filter that takes one view after the other believes what it believed before. Should it have begun with a wrong view, such as a
hand that a network invents behind a screen, the right ones lie beyond its gate. Robust fusion of one moment has no such memory.

Rendered people half behind a screen, one or two cameras with a false arm: 22 to 29 mm (55 to 138 without it).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from posefuse.core import Detections2D, Pose3D, Views
from posefuse.core.arrays import Array, median_apart
from posefuse.core.values import UNSEEN

from .person import Model, Person

# the views of one moment that are known to show the same people -> these people, in the same order
Fuse = Callable[[Views], Pose3D]
# chosen, not fitted: cameras from 7 frames/s on always take part; views are moved by what the tracker knows of the motion since,
# and errors of that grow with time
_NEWEST_NS = 150_000_000
# two views never tell which of them is wrong
_LEAST_CAMERAS = 3
# a view is wrong about a keypoint that it places so far from the others: standard deviations, and metres at the body
_WRONG_SIGMAS, _WRONG_M = 5.0, 0.06
# a keypoint that is tracked so far from where the newest views put it may begin there again. Five rendered people half behind
# screens, views late in five ways: of these 25, one is 120 mm off without it and 30 with it, one 51 and 80, the others the same
_ELSEWHERE_M = 0.12
_SAME_PERSON_M = 0.3
# checks running until a keypoint begins again elsewhere, and the same where its counterpart is tracked: a limb that began swapped
# is put right by this, too (swapping it in the person instead: 38.6 mm where views swap limbs, 35.2 without)
_FAR_CHECKS, _SWAPPED_CHECKS = 2, 3


class CrossCheck:
    """The newest views of one person.

    Attributes:
        checked_ns: when they were last judged.
    """

    def __init__(self, model: Model, fuse: Fuse) -> None:
        self._model, self._fuse = model, fuse
        self._rig, self._skeleton, self._mirror = model.rig, model.skeleton, model.skeleton.mirror
        self._focal_px = np.array([camera.K[0, 0] for camera in self._rig])
        self._centres = self._rig.centres_world()
        self._newest: dict[str, Detections2D] = {}
        self._wrong: dict[str, Array] = {}
        # (K,) in how many checks running keypoints were found elsewhere
        self._far = np.zeros(len(self._skeleton), np.int64)
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
            self._nothing_found()
            return
        now = person.expected(t_ns)[0]
        moved = [self._at(fresh[name], person, t_ns, now) if name in fresh else None for name in self._rig.names]
        together = [
            Detections2D.empty(name, t_ns, self._skeleton) if view is None else view
            for name, view in zip(self._rig.names, moved, strict=True)
        ]
        xyz = self._fused(together, now)
        if xyz is None:
            self._nothing_found()
            return
        self._wrong = self._judged(xyz, together)
        # called where nothing changes, too: so its kernel is compiled before a session begins
        person.begin_again(self._elsewhere(xyz, now))

    def _nothing_found(self) -> None:
        """A check that judged nothing: what the checks before it saw, they did not see in checks running."""
        self._wrong.clear()
        self._far[:] = 0

    def _at(self, view: Detections2D, person: Person, t_ns: int, now: Array) -> Detections2D:
        """The view as it would be at t_ns, moved by what the person moved since."""
        camera = self._rig[view.camera]
        then = person.expected(view.t_ns)[0]
        shift = np.nan_to_num(camera.project(now) - camera.project(then))
        return replace(view, t_ns=t_ns, xy_img=view.xy_img + shift)

    def _fused(self, together: list[Detections2D], now: Array) -> Array | None:
        """(K, 3) the person in the views of one moment; None where most of it is elsewhere: another person."""
        place = np.array([[0 if len(view) else UNSEEN for view in together]])
        xyz = self._fuse(Views.of(together, together[0].t_ns, np.zeros(1, np.int64), place)).xyz_world[0]
        return xyz if median_apart(now, xyz) <= _SAME_PERSON_M else None

    def _judged(self, xyz: Array, together: list[Detections2D]) -> dict[str, Array]:
        """By camera (K,) whether it is wrong about a person at (K, 3)."""
        wrong = {}
        for camera, centre, focal_px, view in zip(self._rig, self._centres, self._focal_px, together, strict=True):
            if not len(view):
                continue
            # limbs of a view that are swapped as a whole are put right by the filter
            expected, depth_m = camera.project(xyz), _apart(xyz, centre)
            same_px, other_px = _apart(view.xy_img[0], expected), _apart(view.xy_img[0], expected[self._mirror])
            swapped = self._model.swapped(other_px, same_px)
            least_px = np.maximum(_WRONG_SIGMAS * view.sigma_px[0], _WRONG_M * focal_px / depth_m)
            # a hidden limb is not where its counterpart is
            doubled = np.isnan(depth_m) & ~swapped & (other_px < least_px[self._mirror])
            wrong[camera.name] = (np.where(swapped, other_px, same_px) > least_px) | doubled
        return wrong

    def _elsewhere(self, xyz: Array, now: Array) -> Array:
        """(K, 3) keypoints that several checks running found far from where they are tracked; NaN for the others."""
        away_m = _apart(xyz, now)
        self._far = np.where(away_m > _ELSEWHERE_M, self._far + 1, 0)
        # networks swap wrists that pass each other, so several views may be wrong in the same way for a while
        patience = np.where(_apart(xyz[self._mirror], now) < away_m, _SWAPPED_CHECKS, _FAR_CHECKS)
        again = self._far >= patience
        self._far[again] = 0
        return np.where(again[:, None], xyz, np.nan)


def _apart(one: Array, other: Array) -> Array:
    """(K,) distances."""
    return np.asarray(np.linalg.norm(one - other, axis=-1))
