"""A camera of Gazebo in our conventions: the inverse of what the export writes."""

import numpy as np

from posefuse.core import SE3, Camera
from posefuse_sim.gazebo.world import CAM_FROM_LINK, CENTRE_PX


def camera_from_gazebo(
    name: str, size_wh: tuple[int, int], focal_px: np.ndarray, centre_px: np.ndarray, world_from_link: SE3
) -> Camera:
    """The camera that a Gazebo camera of these intrinsics (fx, fy) and (cx, cy) is, in our conventions."""
    K = np.array([[focal_px[0], 0, centre_px[0] - CENTRE_PX], [0, focal_px[1], centre_px[1] - CENTRE_PX], [0, 0, 1]])
    rotation = CAM_FROM_LINK @ world_from_link.inverse().matrix()
    return Camera(
        name=name,
        size_wh=size_wh,
        K=K,
        cam_from_world=SE3.from_matrix(rotation, -rotation @ world_from_link.xyz),
        distortion=np.zeros(0),
    )
