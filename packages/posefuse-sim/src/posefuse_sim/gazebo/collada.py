"""COLLADA 1.4.1 (.dae): a mesh in plain colours, the bones it is attached to, and a baked animation.

Written for the strictest reader at hand, Gazebo's:

- metres and Z up are in the file, so it needs no rotation or scaling;
- a joint's id, sid and name are one word, unique in the file and without dots: a channel's target ``a.b/transform`` is
  taken as the component b of a;
- every joint has one ``matrix``; animations replace all of it;
- a vertex is attached to at most four joints; the bind shape matrix is the identity.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from posefuse.core.arrays import Array
from posefuse.foundation.output_file import atomic_file

MOST_WEIGHTS = 4
_UP = "Z_UP"
_BLACK = "0 0 0 1"


@dataclass(frozen=True, eq=False, kw_only=True)
class Mesh:
    """Triangles with one normal per vertex.

    Attributes:
        vertices: (V, 3) m. normals: (V, 3) unit vectors.
        parts: name -> red, green and blue in [0, 1] of a part, matt, and its triangles (F, 3), counter-clockwise from outside.
    """

    vertices: Array
    normals: Array
    parts: Mapping[str, tuple[Array, Array]]


@dataclass(frozen=True, eq=False, kw_only=True)
class ColladaSkeleton:
    """The joints a mesh is attached to, and how they move.

    Attributes:
        names: J joints; the first is the root. parent: (J,), -1 at the root, parents first.
        world_from_joint_rest: (J, 4, 4) poses in which the mesh has its vertices.
        index, weight: (V, 4) joints of each vertex and how much; rows of `weight` sum to 1.
        t_s: (T,) times of the keys. parent_from_joint: (T, J, 4, 4) rigid motions at the keys.
    """

    names: tuple[str, ...]
    parent: Array
    world_from_joint_rest: Array
    index: Array
    weight: Array
    t_s: Array
    parent_from_joint: Array


def joint_name(name: str) -> str:
    """`name` as a joint may be called in a file: letters, digits and underscores."""
    return re.sub(r"\W", "_", name)


def in_parent(world_from_joint: Array, parent: Array) -> Array:
    """(T, J, 4, 4) poses in the parent joint; the root's in the world."""
    local = world_from_joint.copy()
    inner = np.flatnonzero(parent >= 0)
    local[:, inner] = np.linalg.inv(world_from_joint[:, parent[inner]]) @ world_from_joint[:, inner]
    return local


def write_collada(path: Path, mesh: Mesh, skeleton: ColladaSkeleton) -> None:
    """Write a mesh; raises InputError when the file cannot be written."""
    root = ElementTree.Element("COLLADA", xmlns="http://www.collada.org/2005/11/COLLADASchema", version="1.4.1")
    asset = _add(root, "asset")
    _add(_add(asset, "contributor"), "authoring_tool", "posefuse")
    # a fixed date: the same mesh gives the same bytes
    _add(asset, "created", "2000-01-01T00:00:00")
    _add(asset, "modified", "2000-01-01T00:00:00")
    _add(asset, "unit", name="meter", meter="1")
    _add(asset, "up_axis", _UP)
    _effects(root, mesh)
    _geometry(root, mesh)
    _controller(root, skeleton)
    _animations(root, skeleton)
    _scene(root, mesh, skeleton)
    ElementTree.indent(root, "")
    with atomic_file(path) as staged:
        ElementTree.ElementTree(root).write(staged, encoding="utf-8", xml_declaration=True)


def _effects(root: ElementTree.Element, mesh: Mesh) -> None:
    materials, effects = _add(root, "library_materials"), _add(root, "library_effects")
    for name, (colour, _) in mesh.parts.items():
        _add(_add(materials, "material", id=f"{name}-material", name=name), "instance_effect", url=f"#{name}-effect")
        profile = _add(_add(effects, "effect", id=f"{name}-effect"), "profile_COMMON")
        shading = _add(_add(profile, "technique", sid="common"), "lambert")
        _add(_add(shading, "emission"), "color", _BLACK)
        _add(_add(shading, "diffuse"), "color", f"{floats_text(colour)} 1")


def _geometry(root: ElementTree.Element, mesh: Mesh) -> None:
    body = _add(_add(_add(root, "library_geometries"), "geometry", id="mesh", name="mesh"), "mesh")
    for name, values in (("positions", mesh.vertices), ("normals", mesh.normals)):
        _source(body, f"mesh-{name}", values, list("XYZ"))
    _add(_add(body, "vertices", id="mesh-vertices"), "input", semantic="POSITION", source="#mesh-positions")
    for name, (_, faces) in mesh.parts.items():
        triangles = _add(body, "triangles", material=f"{name}-symbol", count=str(len(faces)))
        _add(triangles, "input", semantic="VERTEX", source="#mesh-vertices", offset="0")
        _add(triangles, "input", semantic="NORMAL", source="#mesh-normals", offset="1")
        _add(triangles, "p", " ".join(map(str, np.repeat(faces.ravel(), 2))))


def _controller(root: ElementTree.Element, skeleton: ColladaSkeleton) -> None:
    skin = _add(_add(_add(root, "library_controllers"), "controller", id="skin", name="skin"), "skin", source="#mesh")
    _add(skin, "bind_shape_matrix", floats_text(np.eye(4)))
    _words(skin, "skin-joints", skeleton.names, "JOINT")
    _source(skin, "skin-bind", np.linalg.inv(skeleton.world_from_joint_rest).reshape(-1, 16), None)
    held = skeleton.weight > 0
    _source(skin, "skin-weights", skeleton.weight[held][:, None], ["WEIGHT"])
    joints = _add(skin, "joints")
    _add(joints, "input", semantic="JOINT", source="#skin-joints")
    _add(joints, "input", semantic="INV_BIND_MATRIX", source="#skin-bind")
    weights = _add(skin, "vertex_weights", count=str(len(held)))
    _add(weights, "input", semantic="JOINT", source="#skin-joints", offset="0")
    _add(weights, "input", semantic="WEIGHT", source="#skin-weights", offset="1")
    _add(weights, "vcount", " ".join(map(str, held.sum(axis=1))))
    pairs = np.stack([skeleton.index[held], np.arange(held.sum())], axis=-1)
    _add(weights, "v", " ".join(map(str, pairs.ravel())))


def _animations(root: ElementTree.Element, skeleton: ColladaSkeleton) -> None:
    library = _add(root, "library_animations", id="motion", name="motion")
    for j, name in enumerate(skeleton.names):
        moving = _add(library, "animation", id=f"{name}-motion", name=f"{name}-motion")
        _source(moving, f"{name}-times", skeleton.t_s[:, None], ["TIME"], digits=9)
        _source(moving, f"{name}-poses", skeleton.parent_from_joint[:, j].reshape(-1, 16), None)
        _words(moving, f"{name}-ways", ["LINEAR"] * len(skeleton.t_s), "INTERPOLATION")
        sampler = _add(moving, "sampler", id=f"{name}-sampled")
        for semantic, source in (("INPUT", "times"), ("OUTPUT", "poses"), ("INTERPOLATION", "ways")):
            _add(sampler, "input", semantic=semantic, source=f"#{name}-{source}")
        _add(moving, "channel", source=f"#{name}-sampled", target=f"{name}/transform")


def _scene(root: ElementTree.Element, mesh: Mesh, skeleton: ColladaSkeleton) -> None:
    scene = _add(_add(root, "library_visual_scenes"), "visual_scene", id="scene", name="scene")
    _joints(scene, skeleton)
    instance = _add(_add(scene, "node", id="shape", name="shape", type="NODE"), "instance_controller", url="#skin")
    _add(instance, "skeleton", f"#{skeleton.names[0]}")
    bound = _add(_add(instance, "bind_material"), "technique_common")
    for name in mesh.parts:
        _add(bound, "instance_material", symbol=f"{name}-symbol", target=f"#{name}-material")
    _add(_add(root, "scene"), "instance_visual_scene", url="#scene")


def _joints(scene: ElementTree.Element, skeleton: ColladaSkeleton) -> None:
    nodes: list[ElementTree.Element] = []
    rests = in_parent(skeleton.world_from_joint_rest[None], skeleton.parent)[0]
    for name, parent, rest in zip(skeleton.names, skeleton.parent, rests, strict=True):
        over = scene if parent < 0 else nodes[parent]
        nodes.append(_add(over, "node", id=name, name=name, sid=name, type="JOINT"))
        _add(nodes[-1], "matrix", floats_text(rest), sid="transform")


def _source(parent: ElementTree.Element, name: str, values: Array, axes: list[str] | None, digits: int = 8) -> None:
    """Rows of floats; without names of axes each row is one 4 x 4 matrix."""
    source = _add(parent, "source", id=name)
    _add(source, "float_array", floats_text(values, digits), id=f"{name}-array", count=str(values.size))
    kinds = [("TRANSFORM", "float4x4")] if axes is None else [(axis, "float") for axis in axes]
    _accessor(source, f"{name}-array", len(values), kinds, values.shape[1])


def _words(parent: ElementTree.Element, name: str, words: Sequence[str], axis: str) -> None:
    source = _add(parent, "source", id=name)
    _add(source, "Name_array", " ".join(words), id=f"{name}-array", count=str(len(words)))
    _accessor(source, f"{name}-array", len(words), [(axis, "name")])


def _accessor(source: ElementTree.Element, array: str, count: int, kinds: list[tuple[str, str]], stride: int = 1) -> None:
    common = _add(source, "technique_common")
    accessor = _add(common, "accessor", source=f"#{array}", count=str(count), stride=str(stride))
    for name, kind in kinds:
        _add(accessor, "param", name=name, type=kind)


def _add(parent: ElementTree.Element, tag: str, text: str | None = None, **attributes: str) -> ElementTree.Element:
    child = ElementTree.SubElement(parent, tag, attributes)
    child.text = text
    return child


def floats_text(values: float | Sequence[float] | Array, digits: int = 8) -> str:
    """As text, separated by spaces."""
    return " ".join(f"{value:.{digits}g}" for value in np.asarray(values, np.float64).ravel() + 0.0)
