"""A scene's things as one MuJoCo model, which travels to other processes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from posefuse.core import Camera
from posefuse.core.arrays import Array
from posefuse.core.ideal_image import optics_of
from posefuse.core.se3 import quaternion_product, wxyz_from_rotvec
from posefuse_sim.body import SimulatedBody
from posefuse_sim.body.body import GROUPS
from posefuse_sim.build import LiveScene
from posefuse_sim.props import BOX_TRIANGLES, Prop
from posefuse_sim.surroundings import RoomSettings

from . import textures
from .stage import PROP, mujoco_with

_WALL_THICK_M = 0.05
_SHADOW_PX = 2048
_SAMPLES = 4
# so high that its cone reaches the corners
_LAMP_PER_DIAGONAL = 0.42
# the ambient light, the lamp and each of those that fill the shadows, as shares of full brightness; directions of the latter
AMBIENT, LAMP, FILL = 0.40, 0.48, 0.27
FILL_DIRECTIONS = ((-0.9, 0.3, -0.35), (0.4, -0.9, -0.25))
_LEAST_WEIGHT = 1e-4
# how often the cloth pattern repeats per metre
_CLOTH_PER_M = 2.5


def render_model(live: LiveScene, cameras: Iterable[Camera], backend: str) -> Any:
    """The MuJoCo model of a scene: moving bodies are the bones of all people, then the props.

    Args:
        cameras: those whose images are to be drawn. backend: how this process would draw.

    Raises:
        DependencyError: the extra ``sim`` is missing. ConfigError: a lens sees further aside than an ideal image can show.
    """
    views = [optics_of(camera).view for camera in cameras]
    largest_wh = max(view.width for view in views), max(view.height for view in views)
    scene, room, seed = _Builder(mujoco_with(backend)), live.scene.room, live.scene.seed
    scene.look(room, live.room_size_m, largest_wh)
    scene.picture("cloth", textures.cloth_picture(np.random.default_rng([seed, 31])), specular=0.05, shininess=0.1)
    for i, person in enumerate(live.people):
        scene.person(i, person.body)
    for i, prop in enumerate(live.props):
        scene.prop(f"{PROP}{i}", prop)
    for box in live.boxes:
        scene.box(box.half_m, box.world_from_box.xyz, box.world_from_box.wxyz, rgba=[*box.colour, 1.0])
    scene.room(room, live.room_size_m, np.random.default_rng([seed, 32]))
    return scene.spec.compile()


def lamp_height_m(room: RoomSettings, room_size_m: tuple[float, float]) -> float:
    """Height of the lamp that casts shadows."""
    return max(room.height_m + 0.5, float(np.hypot(*room_size_m)) * _LAMP_PER_DIAGONAL)


class _Builder:
    """A model in the making."""

    def __init__(self, mujoco: Any) -> None:
        self._mj, self.spec = mujoco, mujoco.MjSpec()
        self._world = self.spec.worldbody

    def look(self, room: RoomSettings, size_m: tuple[float, float], largest_wh: tuple[int, int]) -> None:
        """Sizes of images, sky and lights. Lights hang in the world, none on the camera: every view sees the same scene."""
        spec, mj = self.spec, self._mj
        spec.stat.center, spec.stat.extent = [0, 0, 1], float(np.hypot(*size_m)) / 2
        spec.visual.global_.offwidth, spec.visual.global_.offheight = largest_wh
        spec.visual.quality.offsamples, spec.visual.quality.shadowsize = _SAMPLES, _SHADOW_PX
        spec.visual.headlight.ambient = [AMBIENT * room.brightness] * 3
        spec.visual.headlight.diffuse = spec.visual.headlight.specular = [0, 0, 0]
        spec.add_texture(
            name="sky",
            type=mj.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mj.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=[0.86, 0.88, 0.90],
            rgb2=[0.62, 0.64, 0.66],
            width=128,
            height=768,
        )
        lamp = self._world.add_light(pos=[0.8, -0.6, lamp_height_m(room, size_m)], dir=[0, 0, -1], castshadow=room.shadows)
        lamp.cutoff, lamp.exponent = 62, 0.5
        lamp.diffuse, lamp.specular = [LAMP * room.brightness] * 3, [0.1] * 3
        for direction in FILL_DIRECTIONS:
            fill = self._world.add_light(pos=[0, 0, 6], dir=direction, castshadow=False)
            fill.type = mj.mjtLightType.mjLIGHT_DIRECTIONAL
            fill.diffuse, fill.specular = [FILL * room.brightness] * 3, [0, 0, 0]

    def picture(self, name: str, image: Array, **looks: Any) -> None:
        """A texture (H, W, 3), and a material of the same name that shows it."""
        height, width, channels = image.shape
        kind = self._mj.mjtTexture.mjTEXTURE_2D
        texture = self.spec.add_texture(name=name, type=kind, width=width, height=height, nchannel=channels)
        texture.data = np.ascontiguousarray(image).tobytes()
        material = self.spec.add_material(name=name, **looks)
        material.textures[self._mj.mjtTextureRole.mjTEXROLE_RGB] = name

    def person(self, i: int, body: SimulatedBody) -> None:
        """A body as skins: one per colour, since a skin has one colour; blended by MuJoCo itself."""
        for bone in range(len(body.bone_names)):
            self._world.add_body(name=f"p{i}b{bone}", mocap=True)
        group_of_face = body.colour_group[body.faces[:, 0]]
        for group, name in enumerate(GROUPS):
            faces = body.faces[group_of_face == group]
            if len(faces):
                self._skin(f"p{i}", name, body, faces, body.colours[group])

    def _skin(self, person: str, name: str, body: SimulatedBody, faces: Array, colour: Array) -> None:
        used, local = np.unique(faces, return_inverse=True)
        vertices, index, weight = body.vertices_rest[used], body.bone_index[used], body.bone_weight[used]
        held = [np.nonzero((index == bone) & (weight > _LEAST_WEIGHT)) for bone in range(len(body.bone_names))]
        bones = [bone for bone, (rows, _) in enumerate(held) if len(rows)]
        # around the vertical and along it, without a seam
        cloth = np.stack([vertices[:, 0] + vertices[:, 1], vertices[:, 2]], axis=-1) * _CLOTH_PER_M
        self.spec.add_skin(
            name=f"{person}_{name}",
            material="cloth",
            rgba=[*colour, 1.0],
            vert=vertices.ravel(),
            texcoord=cloth.ravel(),
            face=local.ravel(),
            bodyname=[f"{person}b{bone}" for bone in bones],
            # a bone is moved from rest, where its axes are the world's
            bindpos=np.zeros(3 * len(bones)),
            bindquat=np.tile([1.0, 0, 0, 0], len(bones)),
            vertid=[held[bone][0].tolist() for bone in bones],
            vertweight=[weight[held[bone]].tolist() for bone in bones],
        )

    def prop(self, name: str, prop: Prop) -> None:
        """A textured mesh that moves."""
        self.picture(name, prop.texture, specular=0.0)
        self.spec.add_mesh(
            name=name,
            uservert=prop.vertices.ravel(),
            usertexcoord=prop.uv.ravel(),
            userface=BOX_TRIANGLES.ravel(),
            userfacetexcoord=BOX_TRIANGLES.ravel(),
        )
        body = self._world.add_body(name=name, mocap=True)
        body.add_geom(type=self._mj.mjtGeom.mjGEOM_MESH, meshname=name, material=name)

    def box(self, half_m: Array | list[float], xyz: Array | list[float], wxyz: Array, **looks: Any) -> None:
        """A box that stands still."""
        self._world.add_geom(type=self._mj.mjtGeom.mjGEOM_BOX, size=half_m, pos=xyz, quat=wxyz, **looks)

    def room(self, room: RoomSettings, size_m: tuple[float, float], rng: np.random.Generator) -> None:
        """Floor and walls."""
        repeat = 1 / textures.FLOOR_TILE_M
        self.picture("floor", textures.floor_picture(room.floor, rng), texuniform=True, texrepeat=[repeat, repeat], specular=0.1)
        half_x, half_y = size_m[0] / 2, size_m[1] / 2
        self._world.add_geom(type=self._mj.mjtGeom.mjGEOM_PLANE, size=[half_x, half_y, 1], material="floor")
        if room.walls == "none":
            return
        # each wall: direction of the inward normal, distance of the wall, its length
        turns = (np.pi / 2, 0.0, -np.pi / 2, np.pi)
        for i, (turn, distance, length) in enumerate(zip(turns, (half_y, half_x) * 2, size_m * 2, strict=True)):
            self.picture(f"wall{i}", textures.wall_picture(room.walls, length, room.height_m, rng), specular=0.0)
            centre = [-np.cos(turn) * distance, -np.sin(turn) * distance, room.height_m / 2]
            half_m = [length / 2, room.height_m / 2, _WALL_THICK_M]
            self.box(half_m, centre, _wall_quaternion(turn), material=f"wall{i}")


def _wall_quaternion(turn: float) -> Array:
    """Box axes: x along the wall, y up, z towards the inside of the room."""
    upright = wxyz_from_rotvec(np.array([np.pi / 2, 0, 0]))
    facing = wxyz_from_rotvec(np.array([0, 0, turn + np.pi / 2]))
    return quaternion_product(facing, upright)
