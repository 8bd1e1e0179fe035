"""What RViz and Foxglove draw: people as spheres and bones, cameras as pyramids, 2D keypoints over small images."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from posefuse.core import Detections2D, Kind, Pose3D, Rig
from posefuse.core.arrays import Array
from posefuse.core.palette import colour_of

from .messages import header, time_from_ns
from .types import message

_LINE_LIST, _SPHERE_LIST, _TEXT = 5, 7, 9
_SOLIDS = {"cube": 1, "sphere": 2}
_FORGET_AFTER_NS = 500_000_000
_KEYPOINT_M, _BONE_M, _LINE_M, _TEXT_M = 0.045, 0.02, 0.006, 0.12
_PYRAMID_DEPTH_M = 0.25
_GREY = (0.93, 0.93, 0.93)
_PREDICTED_ALPHA = 0.45
# (n, 3) points and (n, 4) colours of a marker that has none
_NO_POINTS, _NO_COLOURS = np.zeros((0, 3)), np.zeros((0, 4))
ANNOTATIONS_TYPE = "foxglove_msgs/msg/ImageAnnotations"
_POINTS, _LINES_2D = 1, 4
_POINT_PX, _LINE_PX = 5.0, 1.5


@lru_cache(maxsize=16)
def side_colours(keypoints: tuple[str, ...]) -> Array:
    """(K, 3) red, green, blue of keypoints by their side."""
    return np.array([colour_of(name).image_rgb for name in keypoints]) / 255


def person_markers(pose: Pose3D, world_frame: str) -> Any:
    """`MarkerArray`: bones and keypoints of everybody (left orange, right blue, predicted see-through), ids above heads."""
    k = pose.skeleton.keypoints
    colours = side_colours(k)
    markers = []
    for n, person in enumerate(map(int, pose.person_id)):
        xyz = pose.xyz_world[n]
        seen = np.isfinite(xyz).all(axis=-1)
        rgba = np.column_stack([colours, np.where(pose.kind[n] == Kind.PREDICTED, _PREDICTED_ALPHA, 1.0)])
        bones = pose.skeleton.bone_indices
        ends = bones[seen[bones].all(axis=-1)].ravel()
        markers.append(
            _marker(
                pose.t_ns, world_frame, "bones", number=person, kind=_LINE_LIST, size_m=_BONE_M, xyz=xyz[ends], rgba=rgba[ends]
            )
        )
        markers.append(
            _marker(
                pose.t_ns,
                world_frame,
                "keypoints",
                number=person,
                kind=_SPHERE_LIST,
                size_m=_KEYPOINT_M,
                xyz=xyz[seen],
                rgba=rgba[seen],
            )
        )
        if seen.any():
            top = np.append(xyz[seen, :2].mean(axis=0), xyz[seen, 2].max() + 2 * _TEXT_M)
            markers.append(_text(pose.t_ns, world_frame, "id", person, top, str(person)))
    return message("visualization_msgs/msg/MarkerArray", markers=markers)


def camera_markers(rig: Rig, t_ns: int, world_frame: str) -> Any:
    """`MarkerArray`: a pyramid and the name of each camera."""
    markers = []
    for c, camera in enumerate(rig):
        w, h = camera.size_wh
        corners = np.array([[0, 0], [w - 1, 0], [w - 1, h - 1], [0, h - 1]])
        # through an ideal lens: where a strong lens has no inverse there would be no corner
        rays = np.linalg.solve(camera.K, np.column_stack([corners, np.ones(4)]).T).T * _PYRAMID_DEPTH_M
        tip, rim = camera.centre_world, camera.cam_from_world.inverse() @ rays
        lines = np.concatenate([[tip, rim[i], rim[i], rim[(i + 1) % 4]] for i in range(4)])
        grey = np.tile([*_GREY, 1.0], (len(lines), 1))
        markers.append(
            _marker(t_ns, world_frame, "cameras", number=c, kind=_LINE_LIST, size_m=_LINE_M, xyz=lines, rgba=grey, forget=False)
        )
        label = tip + [0, 0, 1.5 * _TEXT_M]
        markers.append(_text(t_ns, world_frame, "camera_names", c, label, camera.name, forget=False))
    return message("visualization_msgs/msg/MarkerArray", markers=markers)


def solid_marker(
    t_ns: int, frame: str, ns: str, number: int, *, shape: str, xyz: Array, size_m: Array, rgba: tuple[float, float, float, float]
) -> Any:
    """One ``cube`` or ``sphere`` with edges or diameters `size_m` (3,)."""
    kind, scale = _SOLIDS[shape], tuple(map(float, size_m))
    made = _plain(
        t_ns,
        frame,
        ns,
        number=number,
        kind=kind,
        scale=(scale[0], scale[1], scale[2]),
        xyz=xyz,
        points=_NO_POINTS,
        colours=_NO_COLOURS,
        text="",
        forget=True,
    )
    made.color = _colour(*rgba)
    return made


def _marker(
    t_ns: int, frame: str, ns: str, number: int, kind: int, size_m: float, xyz: Array, rgba: Array, forget: bool = True
) -> Any:
    return _plain(
        t_ns,
        frame,
        ns,
        number=number,
        kind=kind,
        scale=(size_m,) * 3,
        xyz=np.zeros(3),
        points=xyz,
        colours=rgba,
        text="",
        forget=forget,
    )


def _text(t_ns: int, frame: str, ns: str, number: int, xyz: Array, text: str, forget: bool = True) -> Any:
    return _plain(
        t_ns,
        frame,
        ns,
        number=number,
        kind=_TEXT,
        scale=(0.0, 0.0, _TEXT_M),
        xyz=xyz,
        points=_NO_POINTS,
        colours=_NO_COLOURS,
        text=text,
        forget=forget,
    )


def _plain(
    t_ns: int,
    frame: str,
    ns: str,
    number: int,
    kind: int,
    scale: tuple[float, float, float],
    xyz: Array,
    points: Array,
    colours: Array,
    text: str,
    forget: bool,
) -> Any:
    x, y, z = map(float, xyz)
    empty = np.zeros(0, np.uint8)
    pose = message(
        "geometry_msgs/msg/Pose",
        position=message("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=message("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
    )
    return message(
        "visualization_msgs/msg/Marker",
        header=header(t_ns, frame),
        ns=ns,
        id=number,
        type=kind,
        action=0,
        pose=pose,
        scale=message("geometry_msgs/msg/Vector3", x=scale[0], y=scale[1], z=scale[2]),
        color=_colour(*_GREY, 1.0),
        lifetime=message("builtin_interfaces/msg/Duration", sec=0, nanosec=_FORGET_AFTER_NS if forget else 0),
        frame_locked=False,
        points=[message("geometry_msgs/msg/Point", x=x, y=y, z=z) for x, y, z in points.tolist()],
        colors=[_colour(*rgba) for rgba in colours.tolist()],
        texture_resource="",
        texture=message(
            "sensor_msgs/msg/CompressedImage",
            header=header(0, ""),
            format="",
            data=empty,
        ),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=message("visualization_msgs/msg/MeshFile", filename="", data=empty),
        mesh_use_embedded_materials=False,
    )


def _colour(r: float, g: float, b: float, a: float) -> Any:
    return message("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=a)


def annotations_of_view(view: Detections2D, size_wh: tuple[int, int], of_wh: tuple[int, int]) -> Any:
    """`ImageAnnotations` of all people of a view, whose images are `of_wh` px, over an image of `size_wh` px."""
    colours = [_rgba(*rgb) for rgb in side_colours(view.skeleton.keypoints).tolist()]
    scale, bones = np.array(size_wh) / np.array(of_wh), view.skeleton.bone_indices
    drawn = []
    for xy_img, score in zip(view.xy_img, view.score, strict=True):
        # the centre of the first pixel is 0, 0 for us and 0.5, 0.5 there
        xy = (xy_img + 0.5) * scale
        seen = score > 0
        ends = bones[seen[bones].all(axis=-1)]
        drawn.append(_points_2d(view.t_ns, _LINES_2D, xy[ends.ravel()], [colours[i] for i in ends[:, 0]], _LINE_PX))
        drawn.append(_points_2d(view.t_ns, _POINTS, xy[seen], [colours[i] for i in np.flatnonzero(seen)], _POINT_PX))
    return message(ANNOTATIONS_TYPE, circles=[], points=drawn, texts=[])


def _points_2d(t_ns: int, kind: int, xy: Any, colours: list[Any], thickness_px: float) -> Any:
    return message(
        "foxglove_msgs/msg/PointsAnnotation",
        timestamp=time_from_ns(t_ns),
        type=kind,
        points=[message("foxglove_msgs/msg/Point2", x=x, y=y) for x, y in xy.tolist()],
        outline_color=_rgba(1.0, 1.0, 1.0),
        outline_colors=colours,
        fill_color=_rgba(1.0, 1.0, 1.0),
        thickness=thickness_px,
    )


def _rgba(r: float, g: float, b: float) -> Any:
    return message("foxglove_msgs/msg/Color", r=r, g=g, b=b, a=1.0)
