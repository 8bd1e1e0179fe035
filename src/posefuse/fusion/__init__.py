"""Views to Pose3D of one time step: weighted least squares, robust terms, covariance."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .settings import WEIGHTS, FuseSettings, Weights
    from .triangulation import Triangulated, fuse, fuse_over_time, triangulate, whitened_view

__getattr__ = lazy_names(__name__, __file__)
