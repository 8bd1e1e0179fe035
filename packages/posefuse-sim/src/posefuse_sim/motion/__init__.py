"""How simulated people move: settings, and postures at any time."""

from .settings import MotionSettings
