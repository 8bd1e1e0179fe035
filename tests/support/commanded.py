"""What a robot is commanded: an order, or a motion without the orders behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse_teleop.follower import Follower, standing
from posefuse_teleop.limits import Motion
from posefuse_teleop.values import Order, Phase


def commanded(xyz, wxyz, velocity=(0.0, 0.0, 0.0), *, brakes=False) -> Follower:
    """End effectors at (H, 3), (H, 4) that all move at `velocity`."""
    moves = tuple(Motion(position=one, velocity=np.array(velocity)) for one in xyz)
    return replace(standing(xyz, wxyz), moves=moves, limited="brakes" if brakes else "")


def order(seq, sent_ns, xyz, wxyz, **others) -> Order:
    """End effectors are to go to (H, 3), (H, 4), engaged and with open grippers."""
    stated = {"phase": Phase.ENGAGED, "speed_mps": 0.5, "grip": np.zeros(len(xyz), bool)}
    return Order(seq=seq, sent_ns=sent_ns, xyz_world=xyz, wxyz=wxyz, **(stated | others))
