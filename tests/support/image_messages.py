"""Images as a driver of a camera publishes them."""

import cv2

from posefuse_ros.camera_messages import COMPRESSED_TYPE, IMAGE_TYPE
from posefuse_ros.messages import header
from posefuse_ros.types import message


def raw_image(image, t_ns):
    """`sensor_msgs/Image` of (H, W, 3) uint8 RGB."""
    height, width = image.shape[:2]
    form = {"height": height, "width": width, "encoding": "rgb8", "is_bigendian": 0, "step": 3 * width}
    return message(IMAGE_TYPE, header=header(t_ns, "optical_frame"), **form, data=image.ravel())


def jpeg_image(image, t_ns):
    """`sensor_msgs/CompressedImage` of (H, W, 3) uint8 RGB."""
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
    return message(COMPRESSED_TYPE, header=header(t_ns, "optical_frame"), format="rgb8; jpeg compressed bgr8", data=data.ravel())
