"""Association: which detection of each camera is which person, across cameras and time."""

from .assignment import Assignment
from .people import assign, associate
from .settings import AssociateSettings

__all__ = ["Assignment", "AssociateSettings", "assign", "associate"]
