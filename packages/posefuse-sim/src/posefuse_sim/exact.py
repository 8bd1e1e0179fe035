"""What is exactly true about a scene: 3D, 2D in every camera at its own moments, visibility, joints, props."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import SE3, Camera, CameraTruth, JointAngles, Truth
from posefuse.core.arrays import Array
from posefuse.core.skeleton import ANATOMICAL23

from .body import ANGLE_NAMES, JOINTS, SEGMENTS
from .build import LiveScene, live_scene
from .scene import Scene
from .surroundings import FLESH_M, hidden_by_shapes

# a printed point lies on the surface that is drawn; the depth of a pixel is this good
_PRINT_M = 0.02
_ROW_ITERATIONS = 12
_FRAMES_AT_ONCE = 256


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Points of people and props as one camera exposes them, frame by frame.

    Q points: the keypoints of person 0, 1, ..., then the printed points of prop 0, 1, ...

    Attributes:
        xyz_world: (F, Q, 3) where each is when its row is exposed. xy_img: (F, Q, 2) raw px, NaN behind the camera.
        possible: (F, Q) in the image and, for printed points, on a side that faces the camera.
    """

    xyz_world: Array
    xy_img: Array
    possible: Array


def truth_of(scene: Scene) -> Truth:
    """The truth of a scene without rendering it: seconds for minutes of session.

    Visibility is by ray casting against the boxes (exact) and people as capsules (approximate), see `surroundings`; props
    hide nothing here. A rendered session tests the depth of the image instead.
    """
    live = live_scene(scene)
    return truth_with(live, visible_to_all(live))


def visible_to_all(live: LiveScene) -> list[Array]:
    """The visibility (F, Q) of all points by geometry alone, camera by camera; see `SeenPoints` for axis Q."""
    return [np.concatenate([visible_by_shapes(live, i, part) for part in _parts(live, i)]) for i in range(len(live.rig))]


def truth_with(live: LiveScene, visible: list[Array]) -> Truth:
    """The truth with the visibility (F, Q) of every camera found elsewhere; see `SeenPoints` for axis Q."""
    people = len(live.people)
    keypoints = len(ANATOMICAL23)
    views = []
    for i, camera in enumerate(live.rig):
        xy_img = np.concatenate([seen_points(live, i, part).xy_img[:, : people * keypoints] for part in _parts(live, i)])
        shape = (len(live.shots[i]), people, keypoints)
        shown = visible[i][:, : people * keypoints].reshape(shape)
        views.append(CameraTruth(camera=camera.name, t_ns=live.shots[i].t_ns, xy_img=xy_img.reshape(*shape, 2), visible=shown))
    t_s = live.t_ns / 1e9
    return Truth(
        rig=live.rig,
        t_ns=live.t_ns,
        skeleton=ANATOMICAL23,
        person_id=np.arange(people),
        xyz_world=live.keypoints(t_s),
        views=tuple(views),
        joints=_joints(live),
    )


def seen_points(live: LiveScene, camera_index: int, frames: slice) -> SeenPoints:
    """All points as camera number `camera_index` exposes the given ones of its frames."""
    camera = live.rig.cameras[camera_index]
    t_s = live.shots[camera_index].t_ns[frames] / 1e9
    xyz_world, normals = _all_points(live, t_s)
    if camera.readout_s:
        half = camera.readout_s / 2
        early, late = _all_points(live, t_s - half)[0], _all_points(live, t_s + half)[0]
        xyz_world = _when_exposed(camera, early, xyz_world, late)
    facing = ((camera.centre_world - xyz_world) * normals).sum(-1) > 0
    free = ~np.isfinite(normals[..., 0])
    return SeenPoints(xyz_world, camera.project(xyz_world), camera.sees(xyz_world) & (facing | free))


def flesh_of_points(live: LiveScene) -> Array:
    """(Q,) how far before each point a surface may be without hiding it, in metres."""
    printed = sum(len(prop.points_prop) for prop in live.props)
    return np.concatenate([np.tile(FLESH_M, len(live.people)), np.full(printed, _PRINT_M)])


def visible_by_shapes(live: LiveScene, camera_index: int, frames: slice) -> Array:
    """(F, Q) visibility of all points by geometry alone."""
    seen = seen_points(live, camera_index, frames)
    eye = live.rig.cameras[camera_index].centre_world
    people_world = live.keypoints(live.shots[camera_index].t_ns[frames] / 1e9)
    return seen.possible & ~hidden_by_shapes(eye, seen.xyz_world, flesh_of_points(live), live.boxes, people_world)


def prop_truth(live: LiveScene, visible: list[Array]) -> dict[str, Array]:
    """Plain arrays about the props, to be stored next to the truth.

    ``names kinds dictionaries``; per prop number p: ``prop<p>_marker_id`` (M,), ``prop<p>_points_prop`` (Q, 3) (4 corners
    of each marker, then chessboard corners), ``prop<p>_wxyz`` and ``prop<p>_xyz`` at the truth's times (T, ...); and per
    camera number c ``prop<p>_view<c>_wxyz``, ``_xyz`` (F, ...) at mid-exposure, ``_xy_img`` (F, Q, 2), ``_visible`` (F, Q).
    """
    arrays = {
        "names": np.array([prop.name for prop in live.props]),
        "kinds": np.array([prop.kind for prop in live.props]),
        "dictionaries": np.array([prop.dictionary for prop in live.props]),
    }
    for p, (prop, pose) in enumerate(zip(live.props, live.prop_poses(live.t_ns / 1e9), strict=True)):
        arrays |= {f"prop{p}_marker_id": prop.marker_id, f"prop{p}_points_prop": prop.points_prop}
        arrays |= {f"prop{p}_wxyz": pose.wxyz, f"prop{p}_xyz": pose.xyz}
    for c, shots in enumerate(live.shots):
        xy_img = np.concatenate([seen_points(live, c, part).xy_img for part in _parts(live, c)])
        first = len(live.people) * len(ANATOMICAL23)
        for p, (prop, pose) in enumerate(zip(live.props, live.prop_poses(shots.t_ns / 1e9), strict=True)):
            own = slice(first, first + len(prop.points_prop))
            arrays |= {f"prop{p}_view{c}_wxyz": pose.wxyz, f"prop{p}_view{c}_xyz": pose.xyz}
            arrays |= {f"prop{p}_view{c}_xy_img": xy_img[:, own], f"prop{p}_view{c}_visible": visible[c][:, own]}
            first = own.stop
    return arrays


def _parts(live: LiveScene, camera_index: int) -> list[slice]:
    """Frames in portions, so that memory does not grow with the length of a session."""
    count = len(live.shots[camera_index])
    return [slice(first, min(first + _FRAMES_AT_ONCE, count)) for first in range(0, count, _FRAMES_AT_ONCE)]


def _all_points(live: LiveScene, t_s: Array) -> tuple[Array, Array]:
    """World places (T, Q, 3) of all points and the outward normals (T, Q, 3) of printed ones, NaN for keypoints."""
    keypoints = live.keypoints(t_s).reshape(len(t_s), -1, 3)
    places, normals = [keypoints], [np.full_like(keypoints, np.nan)]
    for prop, pose in zip(live.props, live.prop_poses(t_s), strict=True):
        rotation = pose.matrix()
        places.append(np.einsum("tij,qj->tqi", rotation, prop.points_prop) + pose.xyz[:, None])
        normals.append(np.einsum("tij,qj->tqi", rotation, prop.normals_prop))
    return np.concatenate(places, axis=1), np.concatenate(normals, axis=1)


def _when_exposed(camera: Camera, early: Array, middle: Array, late: Array) -> Array:
    """Places (F, Q, 3) at the moment the rolling shutter passes them, by a parabola through three moments.

    A fixed point: the row gives the time, the time the position, the position the row.
    """
    rate, bend = (late - early) / 2, (late + early) / 2 - middle
    last_row = camera.size_wh[1] - 1
    moved = middle
    for _ in range(_ROW_ITERATIONS):
        row = np.nan_to_num(camera.project(moved)[..., 1:], nan=last_row / 2)
        share = np.clip(2 * row / last_row - 1, -1, 1)
        moved = middle + share * rate + share**2 * bend
    return moved


def _joints(live: LiveScene) -> JointAngles | None:
    if not live.people:
        return None
    states = [person.at(live.t_ns / 1e9 - live.scene.start_s) for person in live.people]
    pose = SE3(
        np.stack([state.world_from_segment.wxyz for state in states], axis=1),
        np.stack([state.world_from_segment.xyz for state in states], axis=1),
    )
    angle = np.stack([state.angle_rad for state in states], axis=1)
    return JointAngles(
        t_ns=live.t_ns,
        person_id=np.arange(len(states)),
        segments=SEGMENTS,
        world_from_segment=pose,
        joints=JOINTS,
        angle_names=ANGLE_NAMES,
        angle_rad=angle,
        sigma_rad=np.zeros_like(angle),
    )
