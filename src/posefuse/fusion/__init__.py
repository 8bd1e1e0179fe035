"""Views to Pose3D of one time step: weighted least squares, robust terms, covariance."""

from .instant import fuse
from .settings import WEIGHTS, FuseSettings, Weights
from .triangulate import Triangulated, triangulate

__all__ = ["WEIGHTS", "FuseSettings", "Triangulated", "Weights", "fuse", "triangulate"]
