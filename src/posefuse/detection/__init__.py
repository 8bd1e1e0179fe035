"""Images to Detections2D: detector plug-ins, model cards, regions to look at."""

from typing import TYPE_CHECKING

from posefuse.core.extras import lazy_names

if TYPE_CHECKING:
    from .appearance import with_clothing, with_depth
    from .blazepose import BlazePoseConfig, BlazePoseDetector, default_cards
    from .build import DetectorChoice, fetch_networks, network_settings
    from .card import list_cards, named_networks, read_card
    from .crops import region_from_keypoints, region_from_pose, up_angle_rad
    from .files import fetch_all, status

__getattr__ = lazy_names(__name__, __file__)
