"""Images to Detections2D: detector plug-ins, model cards, regions to look at."""

from .blazepose import BlazePoseConfig, BlazePoseDetector, default_cards
from .clothing import with_clothing
from .models import fetch, fetch_all, list_cards, read_card, status
from .oracle import OracleConfig, OracleDetector, OracleNoise, OracleViews, oracle_views
from .regions import region_from_keypoints, region_from_pose, up_angle_rad

__all__ = [
    "BlazePoseConfig", "BlazePoseDetector", "OracleConfig", "OracleDetector", "OracleNoise",
    "OracleViews", "default_cards", "fetch", "fetch_all", "list_cards", "oracle_views", "read_card",
    "region_from_keypoints", "region_from_pose", "status", "up_angle_rad", "with_clothing",
]  # fmt: skip
