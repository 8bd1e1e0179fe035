"""Estimate and truth to figures."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .metrics import JointErrors, drift, joint_distances_mm, joint_errors, summary, true_xyz_at, typical_nees

__getattr__ = lazy_names(__name__, __file__)
