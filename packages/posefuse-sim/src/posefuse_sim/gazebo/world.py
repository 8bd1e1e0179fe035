"""A scene as an SDF 1.9 world: light, room, occluders, things, people, cameras.

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

from .collada import Mesh, floats_text

SDF_VERSION = "1.9"
WORLD = "posefuse"
_NEAR_M, _FAR_M = 0.05, 80.0
# of simulation time; images are stamped with multiples of it
_STEP_S = 0.001
_GREY_LEVELS = 255


MESHES = "meshes"


def mesh_file(name: str) -> str:
    """Where the mesh of a thing or a person lies, from the world file."""
    return f"{MESHES}/{name}.dae"


def picture_file(name: str) -> str:
    """Where the image on a thing lies, from the world file."""
    return f"{MESHES}/{name}.png"


def image_topic(camera: str) -> str:
    """Topic of a camera's images; Gazebo puts CameraInfo next to it, on ``camera_info``."""
    return f"/{ros_name(camera)}/image"


def world_text(
    live: LiveScene,
    *,
    models: Sequence[tuple[str, SE3]],
    actors: Sequence[str],
    cameras: Sequence[Camera],
) -> str:
    """The world file.

    Args:
        live: whose lights, boxes and sensors, each with a rate of its own. models: name and pose of what stands still.
        actors: names of what moves. cameras: the ideal ones that are drawn, in the order of the rig.
    """
    children = [
        # nothing falls or collides: time passes as fast as images are drawn, at most as fast as the clock
        ("physics", {"@name": "steps", "@type": "ignored", "max_step_size": _numbers(_STEP_S), "real_time_factor": "1"}),
        *(("plugin", _plugin(*system)) for system in _SYSTEMS),
        *_lights(live.scene.room, lamp_height_m(live.scene.room, live.room_size_m)),
        *(("model", _still(name, pose)) for name, pose in models),
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


def _still(name: str, pose: SE3) -> Content:
    matt = {"albedo_map": picture_file(name), "metalness": "0", "roughness": "1"}
    return _shown(name, pose, {"mesh": {"uri": mesh_file(name)}}, _grey(1.0), {"pbr": {"metal": matt}})


def _box(name: str, box: Box) -> Content:
    return _shown(name, box.world_from_box, {"box": {"size": _numbers(2 * box.half_m)}}, f"{_numbers(box.colour)} 1", {})


def _shown(name: str, pose: SE3, shape: Content, colour: str, looks: dict[str, Any]) -> Content:
    """A model that is seen."""
    material = {"ambient": colour, "diffuse": colour, "specular": _grey(0.0), **looks}
    return _static(name, pose, {"visual": {"@name": "visual", "geometry": shape, "material": material}})


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


_UP = np.array([0.0, 0.0, 1.0])


def room_parts(room: RoomSettings, size_m: tuple[float, float], seed: int) -> Iterator[tuple[str, Array, Mesh]]:
    """Floor and walls: name, image and mesh of each; the mesh shows the image file of that name."""
    rng = np.random.default_rng([seed, 32])
    yield "room_floor", textures.floor_picture(room.floor, rng), _shown_on("room_floor", *_floor(size_m))
    for i, (corner, along) in enumerate(_walls(size_m) if room.walls != "none" else ()):
        picture = textures.wall_picture(room.walls, float(np.linalg.norm(along)), room.height_m, rng)
        yield f"room_wall{i}", picture, _shown_on(f"room_wall{i}", *_rectangle(corner, along, room.height_m * _UP))


def _shown_on(name: str, vertices: Array, uv: Array, faces: Array) -> Mesh:
    """A flat mesh that shows an image."""
    normal = np.cross(vertices[1] - vertices[0], vertices[2] - vertices[0])
    normals = np.tile(normal / np.linalg.norm(normal), (len(vertices), 1))
    return Mesh(vertices=vertices, normals=normals, uv=uv, parts={"picture": (f"{name}.png", faces)})


def _floor(size_m: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Tiles of one image each, cut off at the edge: nothing depends on how a renderer repeats images."""
    tile = textures.FLOOR_TILE_M
    edges = [np.concatenate([np.arange(-side / 2, side / 2 - 1e-9, tile), [side / 2]]) for side in size_m]
    parts = []
    for x0, x1 in zip(edges[0][:-1], edges[0][1:], strict=True):
        for y0, y1 in zip(edges[1][:-1], edges[1][1:], strict=True):
            vertices, uv, faces = _rectangle(np.array([x0, y0, 0.0]), np.array([x1 - x0, 0, 0]), np.array([0, y1 - y0, 0]))
            bottom_left = np.array([0.0, 1.0])
            parts.append((vertices, bottom_left + (uv - bottom_left) * [(x1 - x0) / tile, (y1 - y0) / tile], faces))
    count = len(parts[0][0])
    return (
        np.concatenate([part[0] for part in parts]),
        np.concatenate([part[1] for part in parts]),
        np.concatenate([part[2] + count * i for i, part in enumerate(parts)]),
    )


def _walls(size_m: tuple[float, float]) -> list[tuple[Array, Array]]:
    """Lower left corner and direction along each wall as seen from inside, in the order of `render.model`."""
    x, y = size_m[0] / 2, size_m[1] / 2
    corners = [np.array([*corner, 0.0]) for corner in ((x, -y), (-x, -y), (-x, y), (x, y))]
    return [(corner, corners[(i + 1) % 4] - corner) for i, corner in enumerate(corners)]


def _rectangle(corner: Array, right: Array, up: Array) -> tuple[Array, Array, Array]:
    """An image of its own: vertices (4, 3), uv (4, 2) from the image's top left, faces (2, 3) seen from right x up."""
    vertices = np.array([corner, corner + right, corner + right + up, corner + up])
    return vertices, np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]]), np.array([[0, 1, 2], [0, 2, 3]])
