"""Whether poses and clocks of the cameras of a recording agree with their calibration, from the views of the person."""

from __future__ import annotations

import numpy as np

from posefuse.calibration.keypoints import MIN_SCORE, limb_keypoints
from posefuse.core import Rig, ViewSequence

from .rig_monitor import RigFinding, new_monitor_state, observe

# more views add nothing: a network's errors are correlated for longer than this
_EVERY_S = 0.1


def rig_findings(views: ViewSequence, rig: Rig) -> list[RigFinding]:
    """Cameras that were moved, swapped or unsynchronised, as the first person's keypoints show; needs three cameras."""
    period_s = float(np.median(np.diff(views.t_ns))) / 1e9 if len(views.t_ns) > 1 else _EVERY_S
    step = max(1, round(_EVERY_S / period_s))
    limbs = limb_keypoints(views.skeleton.keypoints)
    xy = np.where((views.score[:, 0] >= MIN_SCORE)[..., None], views.xy_img[:, 0], np.nan)[:, :, limbs]
    state, found = new_monitor_state(rig), []
    for t_ns, seen in zip(views.t_ns[::step].tolist(), xy[::step], strict=True):
        state, new = observe(state, rig, t_ns, seen)
        found += new
    return found
