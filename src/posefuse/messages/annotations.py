"""2D keypoints over small images, as Foxglove draws them."""

from __future__ import annotations

from typing import Any

import numpy as np

from posefuse.core import Detections2D

from .markers import side_colours
from .messages import time_from_ns
from .types import message

ANNOTATIONS_TYPE = "foxglove_msgs/msg/ImageAnnotations"
_POINTS, _LINE_LIST = 1, 4
_POINT_PX, _LINE_PX = 5.0, 1.5


def annotations_of_view(view: Detections2D, size_wh: tuple[int, int], of_wh: tuple[int, int]) -> Any:
    """`ImageAnnotations` of all people of a view, whose images are `of_wh` px, over an image of `size_wh` px."""
    colours = [_colour(*rgb) for rgb in side_colours(view.skeleton.keypoints).tolist()]
    scale, bones = np.array(size_wh) / np.array(of_wh), view.skeleton.bone_indices
    drawn = []
    for xy_img, score in zip(view.xy_img, view.score, strict=True):
        # the centre of the first pixel is 0, 0 for us and 0.5, 0.5 there
        xy = (xy_img + 0.5) * scale
        seen = score > 0
        ends = bones[seen[bones].all(axis=-1)]
        drawn.append(_points(view.t_ns, _LINE_LIST, xy[ends.ravel()], [colours[i] for i in ends[:, 0]], _LINE_PX))
        drawn.append(_points(view.t_ns, _POINTS, xy[seen], [colours[i] for i in np.flatnonzero(seen)], _POINT_PX))
    return message(ANNOTATIONS_TYPE, circles=[], points=drawn, texts=[])


def _points(t_ns: int, kind: int, xy: Any, colours: list[Any], thickness_px: float) -> Any:
    return message(
        "foxglove_msgs/msg/PointsAnnotation",
        timestamp=time_from_ns(t_ns),
        type=kind,
        points=[message("foxglove_msgs/msg/Point2", x=x, y=y) for x, y in xy.tolist()],
        outline_color=_colour(1.0, 1.0, 1.0),
        outline_colors=colours,
        fill_color=_colour(1.0, 1.0, 1.0),
        thickness=thickness_px,
    )


def _colour(r: float, g: float, b: float) -> Any:
    return message("foxglove_msgs/msg/Color", r=r, g=g, b=b, a=1.0)
