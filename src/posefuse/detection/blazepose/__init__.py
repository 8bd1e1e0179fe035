"""BlazePose networks by OpenVINO: the default detector, no GPU needed."""

from .detector import BlazePoseConfig, BlazePoseDetector, default_cards

__all__ = ["BlazePoseConfig", "BlazePoseDetector", "default_cards"]
