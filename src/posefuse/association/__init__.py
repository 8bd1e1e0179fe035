"""Association: which detection of each camera is which person, across cameras and time."""

from .assignment import Assignment
from .identity import UNNAMED, Identity, persons_at, with_persons
from .memory import Memory
from .people import assign, associate
from .settings import AssociateSettings

__all__ = [
    "UNNAMED",
    "Assignment",
    "AssociateSettings",
    "Identity",
    "Memory",
    "assign",
    "associate",
    "persons_at",
    "with_persons",
]
