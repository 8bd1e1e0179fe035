"""Messages of views that make no sense, as a faulty or hostile program on the network sends them."""

from collections.abc import Sequence

import built
import numpy as np

from posefuse.core import SKELETONS
from posefuse.core.skeleton import BLAZEPOSE33
from posefuse_ros.messages import message_from_detections
from posefuse_ros.types import encode


def absurd_message(rng: np.random.Generator, cameras: Sequence[str], t_ns: int, received_ns: int) -> bytes:
    """Valid bytes of absurd content: other skeletons, cameras that do not exist, places anywhere, wrong counts and names."""
    skeleton = BLAZEPOSE33 if rng.random() < 0.8 else SKELETONS["coco17"]
    shape, scale = (int(rng.integers(0, 5)), len(skeleton)), 10.0 ** rng.integers(-30, 30)
    xy, score = rng.normal(size=(*shape, 2)) * scale, rng.uniform(0, 1, shape)
    if rng.random() < 0.3:
        xy, score = np.full_like(xy, np.nan), np.zeros_like(score)
    known = {"score": score, "sigma_px": 10.0 ** rng.uniform(-30, 30, shape), "box_img": rng.normal(size=(shape[0], 4)) * scale}
    view = built.detections(str(rng.choice([*cameras, "elsewhere"])), xy, t_ns, skeleton=skeleton, **known)
    msg = message_from_detections(view, {"received": received_ns, "started": 0, "detected": 2**60})
    if rng.random() < 0.3:
        msg.people = int(rng.integers(0, 2**32))
    if rng.random() < 0.1:
        msg.keypoints = ["", *msg.keypoints[1:]]
    return encode(msg)
