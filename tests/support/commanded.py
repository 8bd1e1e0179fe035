"""A motion that a robot is commanded, without the orders behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse_teleop.follower import Follower, as_vector, standing
from posefuse_teleop.limits import Motion


def commanded(xyz, wxyz, velocity=(0.0, 0.0, 0.0), turn_rate=(0.0, 0.0, 0.0), *, brakes=False) -> Follower:
    """End effectors at (H, 3), (H, 4) that all move at `velocity` and turn at `turn_rate`."""
    moves = tuple(Motion(position=as_vector(one), velocity=as_vector(np.array(velocity))) for one in xyz)
    turns = tuple(Motion(velocity=as_vector(np.array(turn_rate))) for _ in xyz)
    return replace(standing(xyz, wxyz), moves=moves, turns=turns, limited="brakes" if brakes else "")
