"""A person as a skinned mesh of their own proportions: for eyes, not for measuring."""

from .mesh import skin_of, skinned_vertices
from .moving import MovingSkin

__all__ = ["MovingSkin", "skin_of", "skinned_vertices"]
