"""A scene as one plans a rig in it: cameras one by one, a room, and a person who walks through it."""

from __future__ import annotations

from dataclasses import replace

from posefuse.core import ConfigError, Rig
from posefuse.core.errors import choices

from .cameras import ListedCameras, PlacedCamera, RingCameras, placed_cameras, rig_from_cameras
from .motion.settings import RandomPath, WalkSettings
from .scene import PersonSettings, Scene
from .surroundings import RoomSettings

_ROOM_M = (7.0, 7.0)
# part of the room that a walk keeps to, and the least that a random path needs
_WALKED, _LEAST_HALF_M = 0.5, 1.0
# between a camera and the wall behind it
_WALL_M = 0.2


def first_plan(count: int = 4) -> Scene:
    """A room with cameras in a ring; a start to change."""
    ring = RingCameras(kind="ring", count=count, radius_m=_ROOM_M[0] / 2 - _WALL_M, height_m=2.2, first_angle_deg=45.0)
    return listed_cameras(Scene(duration_s=6.0, cameras=ring, room=RoomSettings(size_m=_ROOM_M)))


def listed_cameras(scene: Scene) -> Scene:
    """The same scene with every camera by itself, so that each can be moved."""
    return replace(scene, cameras=ListedCameras(kind="list", cameras=placed_cameras(scene.cameras)))


def rig_of_scene(scene: Scene) -> Rig:
    """Its exact cameras; raises ConfigError for one that cannot be."""
    return rig_from_cameras(placed_cameras(scene.cameras))


def camera_of(scene: Scene, name: str) -> PlacedCamera:
    """By name; raises ConfigError where there is none."""
    placed = placed_cameras(scene.cameras)
    for camera in placed:
        if camera.name == name:
            return camera
    raise ConfigError(f"no camera {name!r}; there are: {choices(camera.name for camera in placed)}")


def with_camera(scene: Scene, camera: PlacedCamera) -> Scene:
    """With this camera in place of the one of its name, or at the end; raises ConfigError for one that cannot be."""
    rig_from_cameras((camera,))
    placed = placed_cameras(scene.cameras)
    if any(one.name == camera.name for one in placed):
        cameras = tuple(camera if one.name == camera.name else one for one in placed)
    else:
        cameras = (*placed, camera)
    return replace(scene, cameras=ListedCameras(kind="list", cameras=cameras))


def without_camera(scene: Scene, name: str) -> Scene:
    """Without this camera; raises ConfigError for the last one."""
    cameras = tuple(one for one in placed_cameras(scene.cameras) if one.name != name)
    if not cameras:
        raise ConfigError("a rig needs a camera; add another one before this one is removed")
    return replace(scene, cameras=ListedCameras(kind="list", cameras=cameras))


def free_camera_name(scene: Scene) -> str:
    """``cam00``, ``cam01``, ...: the first that no camera has."""
    taken = {camera.name for camera in placed_cameras(scene.cameras)}
    return next(name for i in range(len(taken) + 1) if (name := f"cam{i:02d}") not in taken)


def with_test_walk(scene: Scene, duration_s: float) -> Scene:
    """With one person who walks around the middle of the room for this time, at a usual speed."""
    size_m = scene.room.size_m or _ROOM_M
    half_x, half_y = (max(_LEAST_HALF_M, _WALKED * size / 2) for size in size_m)
    path = RandomPath(shape="random", low_m=(-half_x, -half_y), high_m=(half_x, half_y))
    person = PersonSettings(motion=WalkSettings(kind="walk", path=path))
    return replace(scene, duration_s=duration_s, people=(person,))
