"""The surfaces of people whose skeletons were fitted, for the outputs that draw them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from posefuse.core import Recording, Sink
from posefuse.core.arrays import Array
from posefuse.formats.bvh import BvhData
from posefuse.kinematics import joints_from_poses
from posefuse.kinematics.animation import FILE_FROM_WORLD, animation_from_joints, animation_gap, seen_throughout
from posefuse.kinematics.skin import skin_of, skinned_vertices
from posefuse.outputs.surface import BodySurface, SurfaceSink


def sinks_with_bodies(sinks: Sequence[Sink], recording: Recording) -> list[Sink]:
    """The outputs, those that can drawing the fitted bodies of the recording: the mesh of the glTF file."""
    if not any(isinstance(sink, SurfaceSink) for sink in sinks):
        return list(sinks)
    surfaces = _surfaces(recording)
    return [sink.with_surfaces(surfaces) if isinstance(sink, SurfaceSink) and surfaces else sink for sink in sinks]


def _surfaces(recording: Recording) -> tuple[BodySurface, ...]:
    """Of the people that were fitted and are known all the time."""
    fitted = recording.provenance.get("fitted_people")
    if not fitted:
        return ()
    joints = joints_from_poses(recording.poses)
    people = [n for n, person in enumerate(recording.poses.person_id.tolist()) if person in fitted]
    whole = [n for n in people if animation_gap(joints, n) is None and seen_throughout(joints, n)]
    animations = [animation_from_joints(recording.poses, joints, n) for n in whole]
    return tuple(_surface(animation) for animation in animations)


def _surface(animation: BvhData) -> BodySurface:
    skin = skin_of(animation)

    def vertices_at(i: int) -> Array:
        rotation, position = ([plane[i : i + 1] for plane in planes] for planes in (animation.rotation, animation.position))
        one = replace(animation, rotation=rotation, position=position)
        return np.asarray(skinned_vertices(one, skin)[0] @ FILE_FROM_WORLD)

    return BodySurface(faces=skin.faces, vertices_at=vertices_at)
