"""Detections2D to Views: who is who, across cameras and time."""

from .people import associate
from .settings import AssociateSettings

__all__ = ["AssociateSettings", "associate"]
