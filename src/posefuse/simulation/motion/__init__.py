"""How simulated people move: settings, and the exact state of a person at any time."""

from .person import MovingPerson, PersonState, build_person
from .settings import MotionSettings

__all__ = ["MotionSettings", "MovingPerson", "PersonState", "build_person"]
