"""A camera of Gazebo in our conventions: the inverse of what the export writes."""

import numpy as np

from posefuse.core import SE3, Camera
from posefuse_sim.gazebo.world import CAM_FROM_LINK, CENTRE_PX


def camera_from_gazebo(read: dict) -> Camera:
    """The camera that one of Gazebo, as `libsdformat` lists it, is in our conventions."""
    (fx, fy), (cx, cy) = read["f"], read["c"]
    rotation = CAM_FROM_LINK @ SE3(np.array(read["wxyz"]), np.array(read["xyz"])).inverse().matrix()
    return Camera(
        name=read["name"],
        size_wh=tuple(read["size"]),
        K=np.array([[fx, 0, cx - CENTRE_PX], [0, fy, cy - CENTRE_PX], [0, 0, 1]]),
        cam_from_world=SE3.from_matrix(rotation, -rotation @ np.array(read["xyz"])),
    )
