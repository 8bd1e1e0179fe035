"""Association: which detection of each camera is which person, across cameras and time."""

from typing import TYPE_CHECKING

from posefuse.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from .candidates import Assignment
    from .hints import Hints, hints_after
    from .identity import UNNAMED, Identity, persons_at, with_persons
    from .memory import Memory
    from .people import assign, associate
    from .settings import AssociateSettings
    from .traits import CLOTHING_TRAITS, clothing_traits, median_clothing

__all__ = [
    "CLOTHING_TRAITS",
    "UNNAMED",
    "Assignment",
    "AssociateSettings",
    "Hints",
    "Identity",
    "Memory",
    "assign",
    "associate",
    "clothing_traits",
    "hints_after",
    "median_clothing",
    "persons_at",
    "with_persons",
]
__getattr__ = lazy_names(__name__, __file__)
