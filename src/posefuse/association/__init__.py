"""Association: which detection of each camera is which person, across cameras and time."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .candidates import Assignment
    from .identity import UNNAMED, Identity, persons_at, with_persons
    from .memory import Memory
    from .people import assign, associate
    from .settings import AssociateSettings
    from .traits import CLOTHING_TRAITS, clothing_traits, median_clothing

__getattr__ = lazy_names(__name__, __file__)
