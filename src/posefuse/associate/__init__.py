"""Detections2D to Views: who is who, across cameras and time."""
