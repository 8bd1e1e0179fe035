"""Estimate and truth to figures."""

from typing import TYPE_CHECKING

from posefuse.foundation.lazy_names import lazy_names

if TYPE_CHECKING:
    from .metrics import JointErrors, joint_distances_mm, joint_errors, summary, true_xyz_at, typical_nees

_HOMES = {
    "JointErrors": "metrics",
    "joint_distances_mm": "metrics",
    "joint_errors": "metrics",
    "summary": "metrics",
    "true_xyz_at": "metrics",
    "typical_nees": "metrics",
}
__all__ = ["JointErrors", "joint_distances_mm", "joint_errors", "summary", "true_xyz_at", "typical_nees"]
__getattr__ = lazy_names(__name__, _HOMES)
