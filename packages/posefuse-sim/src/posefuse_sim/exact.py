"""What is exactly true about the people of a scene: 3D, 2D in every camera at its own moments, visibility, joints."""

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

_ROW_ITERATIONS = 12


@dataclass(frozen=True, eq=False)
class SeenPoints:
    """Points of people as one camera exposes them, frame by frame.

    Q points: the keypoints of person 0, 1, ...

    Attributes:
        xyz_world: (F, Q, 3) where each is when its row is exposed. xy_img: (F, Q, 2) raw px, NaN behind the camera.
        possible: (F, Q) in the image.
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
    return [visible_by_shapes(live, i) for i in range(len(live.rig))]


def truth_with(live: LiveScene, visible: list[Array]) -> Truth:
    """The truth with the visibility (F, Q) of every camera found elsewhere; see `SeenPoints` for axis Q."""
    people = len(live.people)
    views = []
    for i, camera in enumerate(live.rig):
        xy_img = seen_points(live, i, slice(None)).xy_img
        shape = (len(live.shots[i]), people, len(ANATOMICAL23))
        shown = visible[i].reshape(shape)
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
    xyz_world, half = _points(live, t_s), camera.readout_s / 2
    if half:
        xyz_world = _when_exposed(camera, _points(live, t_s - half), xyz_world, _points(live, t_s + half))
    return SeenPoints(xyz_world, camera.project(xyz_world), camera.sees(xyz_world))


def _points(live: LiveScene, t_s: Array) -> Array:
    """World places (T, Q, 3) of all points."""
    return live.keypoints(t_s).reshape(len(t_s), -1, 3)


def flesh_of_points(live: LiveScene) -> Array:
    """(Q,) how far before each point a surface may be without hiding it, in metres."""
    return np.tile(FLESH_M, len(live.people))


def visible_by_shapes(live: LiveScene, camera_index: int) -> Array:
    """(F, Q) visibility of all points by geometry alone."""
    seen = seen_points(live, camera_index, slice(None))
    eye = live.rig.cameras[camera_index].centre_world
    people_world = live.keypoints(live.shots[camera_index].t_ns / 1e9)
    return seen.possible & ~hidden_by_shapes(eye, seen.xyz_world, flesh_of_points(live), live.boxes, people_world)


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
