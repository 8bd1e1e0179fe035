"""What RViz and Foxglove draw: people as spheres and bones, cameras as pyramids."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from posefuse.core import Kind, Pose3D, Rig
from posefuse.core.arrays import Array
from posefuse.core.palette import colour_of

from .messages import WORLD, header, point, quaternion, vector
from .types import message, sparse_message

_LINE_LIST, _SPHERE_LIST, _TEXT = 5, 7, 9
_SOLIDS = {"cube": 1, "sphere": 2}
_FORGET_AFTER_NS = 500_000_000
_KEYPOINT_M, _BONE_M, _LINE_M, _TEXT_M = 0.045, 0.02, 0.006, 0.12
_PYRAMID_DEPTH_M = 0.25
_GREY = (0.93, 0.93, 0.93)
_PREDICTED_ALPHA = 0.45
# the height alone counts
_TEXT_SIZE_M = np.array([0.0, 0.0, _TEXT_M])
_NO_POINTS = np.zeros(0)


@lru_cache(maxsize=16)
def side_colours(keypoints: tuple[str, ...]) -> Array:
    """(K, 3) red, green, blue of keypoints by their side."""
    return np.array([colour_of(name).image_rgb for name in keypoints]) / 255


def person_markers(pose: Pose3D) -> Any:
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
        of_person = {"header": header(pose.t_ns, WORLD), "id": person}
        markers.append(_marker(**of_person, ns="bones", type=_LINE_LIST, size_m=_BONE_M, points=xyz[ends], colours=rgba[ends]))
        markers.append(
            _marker(**of_person, ns="keypoints", type=_SPHERE_LIST, size_m=_KEYPOINT_M, points=xyz[seen], colours=rgba[seen])
        )
        if seen.any():
            top = np.append(xyz[seen, :2].mean(axis=0), xyz[seen, 2].max() + 2 * _TEXT_M)
            markers.append(_marker(**of_person, ns="id", type=_TEXT, size_m=_TEXT_SIZE_M, xyz=top, text=str(person)))
    return message("visualization_msgs/msg/MarkerArray", markers=markers)


def camera_markers(rig: Rig, t_ns: int) -> Any:
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
        of_camera = {"header": header(t_ns, WORLD), "id": c, "lifetime_ns": 0}
        markers.append(_marker(**of_camera, ns="cameras", type=_LINE_LIST, size_m=_LINE_M, points=lines, colours=grey))
        label = tip + [0, 0, 1.5 * _TEXT_M]
        markers.append(_marker(**of_camera, ns="camera_names", type=_TEXT, size_m=_TEXT_SIZE_M, xyz=label, text=camera.name))
    return message("visualization_msgs/msg/MarkerArray", markers=markers)


def solid_marker(
    t_ns: int, frame: str, ns: str, number: int, *, shape: str, xyz: Array, size_m: Array, rgba: tuple[float, float, float, float]
) -> Any:
    """One ``cube`` or ``sphere`` with edges or diameters `size_m` (3,)."""
    return _marker(
        header=header(t_ns, frame), ns=ns, id=number, type=_SOLIDS[shape], size_m=size_m, xyz=xyz, color=_colour(*rgba)
    )  # fmt: skip


def _marker(
    *,
    size_m: float | Array,
    xyz: Array = _NO_POINTS,
    points: Array = _NO_POINTS,
    colours: Array = _NO_POINTS,
    lifetime_ns: int = _FORGET_AFTER_NS,
    **fields: Any,
) -> Any:
    """`visualization_msgs/Marker`; `size_m` (3,) or one for all axes, points (n, 3), colours (n, 4); `fields` as they are."""
    place, upright = point(xyz.tolist() or (0.0, 0.0, 0.0)), quaternion((1.0, 0.0, 0.0, 0.0))
    return sparse_message(
        "visualization_msgs/msg/Marker",
        pose=message("geometry_msgs/msg/Pose", position=place, orientation=upright),
        scale=vector(np.broadcast_to(size_m, 3).astype(np.float64).tolist()),
        lifetime=message("builtin_interfaces/msg/Duration", sec=0, nanosec=lifetime_ns),
        points=[point(one) for one in points.tolist()],
        colors=[_colour(*rgba) for rgba in colours.tolist()],
        **{"color": _colour(*_GREY, 1.0), **fields},
    )


def _colour(r: float, g: float, b: float, a: float) -> Any:
    return message("std_msgs/msg/ColorRGBA", r=r, g=g, b=b, a=a)
