"""A scene's things as one MuJoCo model: plain text and bytes that travel to other processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from posefuse.core.arrays import Array
from posefuse.core.se3 import quaternion_product, wxyz_from_rotvec
from posefuse.simulation.props import Prop
from posefuse.simulation.surroundings import Box, RoomSettings

from . import textures
from .skin import SkinnedBody, skin_file

_WALL_THICK_M = 0.05
_SHADOW_PX = 2048
_SAMPLES = 4
# so high that its cone reaches the corners
_LAMP_PER_DIAGONAL = 0.42


class ColouredBody(SkinnedBody, Protocol):
    """A skinned body whose vertices belong to groups of one colour."""

    @property
    def colour_group(self) -> Array:
        """(V,) place in `colour_names`."""
        ...

    @property
    def colour_names(self) -> tuple[str, ...]:
        """G names of groups of vertices."""
        ...

    @property
    def colours(self) -> Array:
        """(G, 3) RGB of each group."""
        ...


@dataclass(frozen=True)
class RenderModel:
    """What a rendering process needs to know once.

    Attributes:
        xml: MuJoCo's description. assets: its files by name.
        bodies: number of moving bodies: the bones of all people, then the props.
        skin_person: for every skin, the place of its person.
    """

    xml: str
    assets: Mapping[str, bytes]
    bodies: int
    skin_person: tuple[int, ...]


def render_model(
    people: Sequence[ColouredBody],
    boxes: Sequence[Box],
    props: Sequence[Prop],
    room: RoomSettings,
    room_size_m: tuple[float, float],
    largest_wh: tuple[int, int],
    seed: int,
) -> RenderModel:
    """The model of a scene; `largest_wh` is the largest image that will be drawn of it."""
    assets: dict[str, bytes] = {}
    asset_xml, world_xml, skin_xml, skin_person = [], [], [], []
    asset_xml.append(_cloth(assets, seed))
    for i, body in enumerate(people):
        world_xml += [f'<body name="p{i}b{bone}" mocap="true"/>' for bone in range(len(body.bone_names))]
        skins = _skins(i, body, assets)
        skin_xml += skins
        skin_person += [i] * len(skins)
    for i, prop in enumerate(props):
        asset_xml.append(_prop_assets(i, prop, assets))
        geom = f'<geom type="mesh" mesh="prop{i}" material="prop{i}"/>'
        world_xml.append(f'<body name="prop{i}" mocap="true">{geom}</body>')
    world_xml += [_box_geom(box) for box in boxes]
    room_assets, room_geoms = _room(room, room_size_m, assets, seed)
    bodies = sum(len(body.bone_names) for body in people) + len(props)
    xml = _XML.format(
        extent=float(np.hypot(*room_size_m)) / 2,
        width=largest_wh[0],
        height=largest_wh[1],
        samples=_SAMPLES,
        shadow_px=_SHADOW_PX,
        ambient=0.40 * room.brightness,
        key=0.48 * room.brightness,
        fill=0.27 * room.brightness,
        lamp=lamp_height_m(room, room_size_m),
        shadow="true" if room.shadows else "false",
        assets="".join(asset_xml) + room_assets,
        world=room_geoms + "".join(world_xml),
        skins="".join(skin_xml),
    )
    return RenderModel(xml, assets, bodies, tuple(skin_person))


def lamp_height_m(room: RoomSettings, room_size_m: tuple[float, float]) -> float:
    """Height of the lamp that casts shadows."""
    return max(room.height_m + 0.5, float(np.hypot(*room_size_m)) * _LAMP_PER_DIAGONAL)


# lights hang in the world, none on the camera: every view sees the same scene
_XML = """<mujoco>
<compiler angle="radian" autolimits="true"/>
<statistic center="0 0 1" extent="{extent:.4f}"/>
<visual>
<global offwidth="{width}" offheight="{height}"/>
<headlight ambient="{ambient:.3f} {ambient:.3f} {ambient:.3f}" diffuse="0 0 0" specular="0 0 0"/>
<quality offsamples="{samples}" shadowsize="{shadow_px}"/>
</visual>
<asset>
<texture name="sky" type="skybox" builtin="gradient" rgb1="0.86 0.88 0.90" rgb2="0.62 0.64 0.66" width="128" height="128"/>
{assets}
</asset>
<worldbody>
<light pos="0.8 -0.6 {lamp}" dir="0 0 -1" cutoff="62" exponent="0.5" castshadow="{shadow}"
 diffuse="{key} {key} {key}" specular="0.1 0.1 0.1"/>
<light pos="0 0 6" dir="-0.9 0.3 -0.35" directional="true" castshadow="false" diffuse="{fill} {fill} {fill}" specular="0 0 0"/>
<light pos="0 0 6" dir="0.4 -0.9 -0.25" directional="true" castshadow="false" diffuse="{fill} {fill} {fill}" specular="0 0 0"/>
{world}
</worldbody>
<deformable>{skins}</deformable>
</mujoco>"""


def _cloth(assets: dict[str, bytes], seed: int) -> str:
    assets["cloth.png"] = textures.png(textures.cloth_picture(np.random.default_rng([seed, 31])))
    material = '<material name="cloth" texture="cloth" specular="0.05" shininess="0.1"/>'
    return f'<texture name="cloth" type="2d" file="cloth.png"/>{material}'


def _skins(person: int, body: ColouredBody, assets: dict[str, bytes]) -> list[str]:
    skins = []
    group_of_face = body.colour_group[body.faces[:, 0]]
    for group, name in enumerate(body.colour_names):
        faces = body.faces[group_of_face == group]
        if len(faces):
            file = f"p{person}_{name}.skn"
            assets[file] = skin_file(body, faces, f"p{person}b")
            skins.append(
                f'<skin name="p{person}_{name}" file="{file}" material="cloth" rgba="{_numbers(body.colours[group])} 1"/>'
            )
    return skins


def _prop_assets(i: int, prop: Prop, assets: dict[str, bytes]) -> str:
    assets[f"prop{i}.png"] = textures.png(prop.texture)
    return (
        f'<texture name="prop{i}" type="2d" file="prop{i}.png"/><material name="prop{i}" texture="prop{i}" specular="0"/>'
        f'<mesh name="prop{i}" vertex="{_numbers(prop.vertices)}" texcoord="{_numbers(prop.uv)}" face="{_numbers(prop.faces)}"/>'
    )


def _box_geom(box: Box) -> str:
    pose = box.world_from_box
    return (
        f'<geom type="box" size="{_numbers(box.half_m)}" pos="{_numbers(pose.xyz)}" quat="{_numbers(pose.wxyz)}" '
        f'rgba="{_numbers(box.colour)} 1"/>'
    )


def _room(room: RoomSettings, size_m: tuple[float, float], assets: dict[str, bytes], seed: int) -> tuple[str, str]:
    rng = np.random.default_rng([seed, 32])
    assets["floor.png"] = textures.png(textures.floor_picture(room.floor, rng))
    repeat = 1 / textures.FLOOR_TILE_M
    xml = (
        '<texture name="floor" type="2d" file="floor.png"/>'
        f'<material name="floor" texture="floor" texuniform="true" texrepeat="{repeat} {repeat}" specular="0.1"/>'
    )
    half_x, half_y = size_m[0] / 2, size_m[1] / 2
    geoms = f'<geom type="plane" size="{half_x} {half_y} 1" material="floor"/>'
    if room.walls == "none":
        return xml, geoms
    # each wall: direction of the inward normal, distance of the wall, its length
    for i, (turn, distance, length) in enumerate(
        ((np.pi / 2, half_y, size_m[0]), (0.0, half_x, size_m[1]), (-np.pi / 2, half_y, size_m[0]), (np.pi, half_x, size_m[1]))
    ):
        assets[f"wall{i}.png"] = textures.png(textures.wall_picture(room.walls, length, room.height_m, rng))
        xml += f'<texture name="wall{i}" type="2d" file="wall{i}.png"/><material name="wall{i}" texture="wall{i}" specular="0"/>'
        centre = [-np.cos(turn) * distance, -np.sin(turn) * distance, room.height_m / 2]
        geoms += (
            f'<geom type="box" size="{length / 2} {room.height_m / 2} {_WALL_THICK_M}" pos="{_numbers(centre)}" '
            f'quat="{_numbers(_wall_quaternion(turn))}" material="wall{i}"/>'
        )
    return xml, geoms


def _wall_quaternion(turn: float) -> Array:
    """Box axes: x along the wall, y up, z towards the inside of the room."""
    upright = wxyz_from_rotvec(np.array([np.pi / 2, 0, 0]))
    facing = wxyz_from_rotvec(np.array([0, 0, turn + np.pi / 2]))
    return quaternion_product(facing, upright)


def _numbers(values: object) -> str:
    return " ".join(f"{value:.9g}" for value in np.asarray(values, np.float64).ravel())
