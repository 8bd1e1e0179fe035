"""Views to Pose3D of one time step: weighted least squares, robust terms, covariance."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .settings import WEIGHTS, FuseSettings, Weights
    from .triangulation import Triangulated, fuse, fuse_over_time, triangulate, whitened_view

# for `mypy --strict` of a program: what an installed package only imports, it does not offer
__all__ = [
    "WEIGHTS", "FuseSettings", "Triangulated", "Weights", "fuse", "fuse_over_time", "triangulate", "whitened_view",
]  # fmt: skip

__getattr__ = lazy_names(__name__, __file__)
