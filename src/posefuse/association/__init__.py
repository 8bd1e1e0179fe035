"""Association: which detection of each camera is which person, across cameras and time."""

from .assignment import Assignment
from .memory import Memory
from .people import assign, associate
from .settings import AssociateSettings

__all__ = ["Assignment", "AssociateSettings", "Memory", "assign", "associate"]
