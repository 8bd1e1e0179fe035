"""Which keypoints of a person are good enough to judge cameras and clocks by."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.skeleton import SIDES

# Limbs move most, so they carry most information; detectors mark the face even when it is not visible.
_LIMBS = frozenset(f"{side}_{part}" for side in SIDES for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))
# detector score from which a keypoint counts as seen
MIN_SCORE = 0.5


def limb_keypoints(keypoints: Sequence[str]) -> Array:
    """Indices of the limb joints among a skeleton's names; all indices where it has none of them."""
    found = [k for k, name in enumerate(keypoints) if name in _LIMBS]
    return np.array(found or range(len(keypoints)))
