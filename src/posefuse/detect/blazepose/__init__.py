"""BlazePose networks by OpenVINO: the default 2D estimator, no GPU needed."""

from .detector import BlazePoseConfig, BlazePoseDetector

__all__ = ["BlazePoseConfig", "BlazePoseDetector"]
