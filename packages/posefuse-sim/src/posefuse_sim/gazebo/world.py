"""A scene as an SDF 1.9 world: light, room, occluders, people, cameras.

**Axes.** A Gazebo camera looks along its own +X, with +Y to the left and +Z up; ours is OpenCV's (x right, y down, z forward).

**Pixels.** Gazebo builds its OpenGL projection so that the pixel coordinate u of a point runs from 0 at the left *edge* of the
image to its width at the right edge; the centre of the first pixel is at 0.5. Ours is at 0. So cx and cy of a world file, and of
the CameraInfo that Gazebo publishes, are half a pixel more than ours (`CENTRE_PX`).

**Lens.** Gazebo's renderer draws ideal pinhole images, of square or oblong pixels. A camera with a lens, or with skewed axes,
is exported as an ideal camera wide enough for all that the lens sees (`core.ideal_image`); the intake applies the lens.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any
from xml.etree import ElementTree

import numpy as np

from posefuse.core import SE3, Camera
from posefuse.core.arrays import Array
from posefuse.foundation.parsing import ros_name
from posefuse_sim.build import LiveScene
from posefuse_sim.cameras import SensorSettings
from posefuse_sim.render import textures
from posefuse_sim.render.model import AMBIENT, FILL, FILL_DIRECTIONS, LAMP, lamp_height_m
from posefuse_sim.surroundings import Box, RoomSettings

from .collada import floats_text

SDF_VERSION = "1.9"
WORLD = "posefuse"
_NEAR_M, _FAR_M = 0.05, 80.0
# of simulation time; images are stamped with multiples of it
_STEP_S = 0.001
_GREY_LEVELS = 255


MESHES = "meshes"


def mesh_file(name: str) -> str:
    """Where the mesh of a person lies, from the world file."""
    return f"{MESHES}/{name}.dae"


def image_topic(camera: str) -> str:
    """Topic of a camera's images; Gazebo puts CameraInfo next to it, on ``camera_info``."""
    return f"/{ros_name(camera)}/image"


def world_text(live: LiveScene, *, actors: Sequence[str], cameras: Sequence[Camera]) -> str:
    """The world file.

    Args:
        live: whose room, lights, boxes and sensors, each with a rate of its own. actors: names of what moves.
        cameras: the ideal ones that are drawn, in the order of the rig.
    """
    children = [
        # nothing falls or collides: time passes as fast as images are drawn, at most as fast as the clock
        ("physics", {"@name": "steps", "@type": "ignored", "max_step_size": _numbers(_STEP_S), "real_time_factor": "1"}),
        *(("plugin", _plugin(*system)) for system in _SYSTEMS),
        *_lights(live.scene.room, lamp_height_m(live.scene.room, live.room_size_m)),
        *(("model", _box(name, box)) for name, box in room_boxes(live.scene.room, live.room_size_m, live.scene.seed)),
        *(("model", _box(f"occluder{i}", box)) for i, box in enumerate(live.boxes)),
        *(("actor", _actor(name)) for name in actors),
        *(("model", _camera(camera, placed.sensor)) for camera, placed in zip(cameras, live.placed, strict=True)),
    ]
    root = ElementTree.Element("sdf", version=SDF_VERSION)
    world = ElementTree.SubElement(root, "world", name=WORLD)
    for tag, content in children:
        _fill(ElementTree.SubElement(world, tag), content)
    ElementTree.indent(root, "  ")
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


# of an element: its text, or its attributes (``@name``) and what is in it
Content = str | dict[str, Any]
_SYSTEMS = (("sensors", "Sensors"), ("scene-broadcaster", "SceneBroadcaster"), ("user-commands", "UserCommands"))


def _fill(element: ElementTree.Element, content: Content) -> None:
    if isinstance(content, str):
        element.text = content
        return
    for tag, part in content.items():
        if tag.startswith("@"):
            element.set(tag[1:], part)
        else:
            _fill(ElementTree.SubElement(element, tag), part)


def _plugin(system: str, name: str) -> Content:
    engine = {"render_engine": "ogre2"} if name == "Sensors" else {}
    return {"@filename": f"gz-sim-{system}-system", "@name": f"gz::sim::systems::{name}", **engine}


def _lights(room: RoomSettings, lamp_m: float) -> list[tuple[str, Content]]:
    ambient, shadows = _grey(AMBIENT * room.brightness), "true" if room.shadows else "false"
    lamp = {
        "pose": f"0.8 -0.6 {_numbers(lamp_m)} 0 0 0",
        **_shine(LAMP * room.brightness, shadows, (0.0, 0.0, -1.0)),
        "attenuation": {"range": "100", "constant": "1", "linear": "0", "quadratic": "0"},
        "spot": {"inner_angle": "1.2", "outer_angle": "2.16", "falloff": "0.5"},
    }
    fills = [{"pose": "0 0 6 0 0 0", **_shine(FILL * room.brightness, "false", direction)} for direction in FILL_DIRECTIONS]
    return [
        ("scene", {"ambient": ambient, "background": "0.74 0.76 0.78 1", "shadows": shadows, "grid": "false"}),
        ("light", {"@name": "lamp", "@type": "spot", **lamp}),
        *(("light", {"@name": f"fill{i}", "@type": "directional", **fill}) for i, fill in enumerate(fills)),
    ]


def _shine(level: float, shadows: str, direction: tuple[float, float, float]) -> dict[str, Any]:
    return {"cast_shadows": shadows, "diffuse": _grey(level), "specular": _grey(0.0), "direction": _numbers(direction)}


def _box(name: str, box: Box) -> Content:
    colour = f"{_numbers(box.colour)} 1"
    material = {"ambient": colour, "diffuse": colour, "specular": _grey(0.0)}
    visual = {"@name": "visual", "geometry": {"box": {"size": _numbers(2 * box.half_m)}}, "material": material}
    return _static(name, box.world_from_box, {"visual": visual})


def _static(name: str, pose: SE3, held: dict[str, Any]) -> Content:
    return {"@name": name, "static": "true", "pose": pose_text(pose), "link": {"@name": "link", **held}}


def _actor(name: str) -> Content:
    # no <trajectory>: with one, Gazebo puts a curve of its own in the place of the root's motion
    mesh = mesh_file(name)
    script = {"loop": "true", "delay_start": "0", "auto_start": "true"}
    return {"@name": name, "skin": {"filename": mesh}, "animation": {"@name": "motion", "filename": mesh}, "script": script}


def _camera(camera: Camera, sensor: SensorSettings) -> Content:
    width, height = camera.size_wh
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2] + CENTRE_PX, camera.K[1, 2] + CENTRE_PX
    intrinsics = {name: _numbers(value) for name, value in zip(("fx", "fy", "cx", "cy", "s"), (fx, fy, cx, cy, 0.0), strict=True)}
    noise = {"type": "gaussian", "mean": "0", "stddev": _numbers(sensor.noise_dn / _GREY_LEVELS)}
    optics = {
        "horizontal_fov": _numbers(2 * np.arctan(width / 2 / fx)),
        "image": {"width": str(width), "height": str(height), "format": "R8G8B8"},
        "clip": {"near": _numbers(_NEAR_M), "far": _numbers(_FAR_M)},
        **({"noise": noise} if sensor.noise_dn else {}),
        "lens": {"intrinsics": intrinsics},
    }
    assert sensor.rate_hz is not None, "`shown_scene` sets it"
    times = {"topic": image_topic(camera.name), "update_rate": _numbers(sensor.rate_hz), "always_on": "true"}
    described = {"@name": "camera", "@type": "camera", **times, "camera": optics}
    return _static(camera.name, world_from_link(camera), {"sensor": described})


def pose_text(pose: SE3) -> str:
    """``x y z roll pitch yaw`` of SDF: rotation Rz(yaw) Ry(pitch) Rx(roll), radians."""
    r = pose.matrix()
    across = np.hypot(r[0, 0], r[1, 0])
    pitch = np.arctan2(-r[2, 0], across)
    if across > 1e-9:
        roll, yaw = np.arctan2(r[2, 1], r[2, 2]), np.arctan2(r[1, 0], r[0, 0])
    else:
        # looking straight up or down: roll and yaw turn about one line, and roll takes it all
        roll, yaw = np.arctan2(-r[1, 2], r[1, 1]), 0.0
    return f"{_numbers(pose.xyz)} {_numbers([roll, pitch, yaw])}"


def _grey(level: float) -> str:
    return f"{level:.6g} {level:.6g} {level:.6g} 1"


def _numbers(values: float | Sequence[float] | Array) -> str:
    # what is read back is the same to the last nanometre
    return floats_text(values, digits=15)


CENTRE_PX = 0.5
# columns: Gazebo's forward, left, up in our camera axes
CAM_FROM_LINK = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


def world_from_link(camera: Camera) -> SE3:
    """Pose of a Gazebo camera that sees what `camera` sees."""
    world_from_cam = camera.cam_from_world.inverse()
    return SE3.from_matrix(world_from_cam.matrix() @ CAM_FROM_LINK, world_from_cam.xyz)


# of what stands for the floor and the walls
_THICK_M = 0.05


def room_boxes(room: RoomSettings, size_m: tuple[float, float], seed: int) -> Iterator[tuple[str, Box]]:
    """Floor and walls, each a board around the room in the mean colour of its picture."""
    rng = np.random.default_rng([seed, 32])
    half_x, half_y, half_z = size_m[0] / 2, size_m[1] / 2, room.height_m / 2
    yield "room_floor", _board((half_x, half_y, _THICK_M), (0.0, 0.0, -_THICK_M), textures.floor_picture(room.floor, rng))
    if room.walls == "none":
        return
    for i, (side, sign) in enumerate(((0, 1.0), (1, -1.0), (0, -1.0), (1, 1.0))):
        half, centre = np.array([half_x, half_y, half_z]), np.array([0.0, 0.0, half_z])
        half[side], centre[side] = _THICK_M, sign * ((half_x, half_y)[side] + _THICK_M)
        picture = textures.wall_picture(room.walls, size_m[1 - side], room.height_m, rng)
        yield f"room_wall{i}", _board(half, centre, picture)


def _board(half_m: Sequence[float] | Array, centre_m: Sequence[float] | Array, picture: Array) -> Box:
    red, green, blue = (picture.mean(axis=(0, 1)) / _GREY_LEVELS).tolist()
    return Box(np.array(half_m), SE3.from_rotvec(np.zeros(3), np.array(centre_m)), (red, green, blue))
