"""A person as a skinned mesh of their own proportions: for eyes, not for measuring."""

from .mesh import skin_of

__all__ = ["skin_of"]
