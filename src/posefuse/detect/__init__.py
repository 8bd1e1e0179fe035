"""Images to Detections2D: 2D estimator plug-ins, model cards, regions to look at."""

from .blazepose import BlazePoseConfig, BlazePoseDetector
from .models import default_cache_dir, fetch, fetch_all, list_cards, read_card, status
from .regions import region_from_keypoints, region_from_pose, up_angle_rad

__all__ = [
    "BlazePoseConfig", "BlazePoseDetector", "default_cache_dir", "fetch", "fetch_all", "list_cards", "read_card",
    "region_from_keypoints", "region_from_pose", "status", "up_angle_rad",
]  # fmt: skip
