"""Cameras as Gazebo has them.

**Axes.** A Gazebo camera looks along its own +X, with +Y to the left and +Z up; ours is OpenCV's (x right, y down, z forward).

**Pixels.** Gazebo builds its OpenGL projection so that the pixel coordinate u of a point runs from 0 at the left *edge* of the
image to its width at the right edge; the centre of the first pixel is at 0.5. Ours is at 0. So cx and cy of a world file, and of
the CameraInfo that Gazebo publishes, are half a pixel more than ours (`CENTRE_PX`).

**Lens.** Gazebo's renderer draws ideal pinhole images, of square or oblong pixels. A camera with a lens, or with skewed axes,
is exported as an ideal camera wide enough for all that the lens sees (`core.ideal_image`); the intake applies the lens.
"""

from __future__ import annotations

import numpy as np

from posefuse.core import SE3, Camera
from posefuse.core.arrays import Array

CENTRE_PX = 0.5
# columns: Gazebo's forward, left, up in our camera axes
CAM_FROM_LINK = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


def world_from_link(camera: Camera) -> SE3:
    """Pose of a Gazebo camera that sees what `camera` sees."""
    world_from_cam = camera.cam_from_world.inverse()
    return SE3.from_matrix(world_from_cam.matrix() @ CAM_FROM_LINK, world_from_cam.xyz)


def camera_from_gazebo(name: str, size_wh: tuple[int, int], focal_px: Array, centre_px: Array, world_from_link: SE3) -> Camera:
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
