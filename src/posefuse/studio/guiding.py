"""When a recording of a target is enough for its step of a calibration, and what to do until then: pure functions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.calibration.targets.coverage import ENOUGH_SHARE, ENOUGH_TOGETHER, TargetCoverage
from posefuse.core.arrays import Array

from .calibrations import Step


def enough_for(step: Step, found: TargetCoverage) -> bool:
    """Lenses need each image covered; a verification needs each camera to share views with another; positions need both."""
    if step == "intrinsics":
        return bool((found.share >= ENOUGH_SHARE).all())
    if step == "verify":
        # three times the least that `verify` takes
        return bool((_shared(found) >= ENOUGH_TOGETHER).all())
    return found.enough


def advice_for(step: Step, found: TargetCoverage) -> str:
    """What to do next, in words."""
    if enough_for(step, found):
        return "enough: stop moving the target"
    if step == "intrinsics":
        # no camera needs another one: as if all were linked
        linked = np.where(np.eye(len(found.cameras), dtype=bool), found.together, ENOUGH_TOGETHER)
        return replace(found, together=linked).advice()
    if step == "verify":
        shared = _shared(found)
        camera = int(np.argmin(shared))
        return f"show the board to {found.cameras[camera]} and another camera: {shared[camera]} of {ENOUGH_TOGETHER}"
    return found.advice()


def _shared(found: TargetCoverage) -> Array:
    """(C,) moments that each camera shares with the one it shares most with."""
    return np.asarray(np.where(np.eye(len(found.cameras), dtype=bool), 0, found.together).max(axis=1))
