"""Segment poses and joint angles over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from .arrays import Array, FrozenArrays, frozen_fields, taken
from .errors import InputError, ShapeError, choices
from .se3 import SE3


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class AngleSeries(FrozenArrays):
    """One joint angle of one person over time.

    Attributes:
        name: joint and angle, e.g. ``left_knee flexion``.
        t_s: (T,) session seconds.
        rad, sigma_rad: (T,) the angle and its standard deviation; NaN where undefined.
    """

    name: str
    t_s: Array
    rad: Array
    sigma_rad: Array

    def __post_init__(self) -> None:
        frozen_fields(self, dict.fromkeys(("t_s", "rad", "sigma_rad"), "T"))

    @property
    def deg(self) -> Array:
        """(T,) the angle in degrees."""
        return np.degrees(self.rad)

    @property
    def sigma_deg(self) -> Array:
        """(T,) its standard deviation in degrees."""
        return np.degrees(self.sigma_rad)

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        known = self.deg[np.isfinite(self.deg)]
        if not len(known):
            return f"AngleSeries({self.name}, {len(self)} time steps, undefined)"
        return f"AngleSeries({self.name}, {len(self)} time steps, {known.min():.1f} to {known.max():.1f} deg)"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class JointAngles(FrozenArrays):
    """Segment poses and joint angles over time; ``angles["left_knee", "flexion"]`` is one of them.

    Attributes:
        t_ns: (T,).
        person_id: (N,).
        segments: S names.
        world_from_segment: SE3 of batch (T, N, S); NaN where undefined.
        joints: J names, each with three angles `angle_names[j]` in its declared sequence.
        angle_rad: (T, N, J, 3); NaN where undefined.
        sigma_rad: (T, N, J, 3); NaN where undefined.
    """

    t_ns: Array
    person_id: Array
    segments: tuple[str, ...]
    world_from_segment: SE3
    joints: tuple[str, ...]
    angle_names: tuple[tuple[str, str, str], ...]
    angle_rad: Array
    sigma_rad: Array

    def __post_init__(self) -> None:
        sizes = frozen_fields(self, {"t_ns": "T", "person_id": "N", "angle_rad": "T N J 3", "sigma_rad": "T N J 3"})
        if self.world_from_segment.batch != (sizes["T"], sizes["N"], len(self.segments)):
            raise ShapeError(f"JointAngles.world_from_segment: expected batch (T, N, S), got {self.world_from_segment.batch}")
        if not sizes["J"] == len(self.joints) == len(self.angle_names):
            raise ShapeError(
                f"JointAngles: {sizes['J']} angles for {len(self.joints)} joints and {len(self.angle_names)} angle names"
            )

    @property
    def deg(self) -> Array:
        """All angles in degrees, (T, N, J, 3)."""
        return np.asarray(np.degrees(self.angle_rad))

    @property
    def sigma_deg(self) -> Array:
        """Their standard deviations in degrees, (T, N, J, 3)."""
        return np.asarray(np.degrees(self.sigma_rad))

    @property
    def angles(self) -> list[tuple[str, str]]:
        """Joint and name of each angle in the order of `angle_rad`."""
        return [(joint, name) for joint, names in zip(self.joints, self.angle_names, strict=True) for name in names]

    def __len__(self) -> int:
        """How many time steps."""
        return len(self.t_ns)

    def __repr__(self) -> str:
        return f"JointAngles({len(self)} time steps, person {self.person_id.tolist()}, {len(self.joints)} joints of 3 angles)"

    def __getitem__(self, key: tuple[str, str]) -> AngleSeries:
        """The angle (joint, angle name) of the one person in it.

        Raises:
            InputError: unknown joint or angle (the message lists the known ones), or several people: select one with `of`.
        """
        if not (isinstance(key, tuple) and len(key) == 2):
            raise InputError(f'joint angles: expected [joint, angle], e.g. ["left_knee", "flexion"], got {key!r}')
        if len(self.person_id) != 1:
            raise InputError(
                f"joint angles: expected one person, got {len(self.person_id)} (ids {choices(map(str, self.person_id))}); "
                "choose one with .of(person_id)"
            )
        joint, angle = key
        if joint not in self.joints:
            raise InputError(f"joint angles: no joint {joint!r}; there are: {choices(self.joints)}")
        j = self.joints.index(joint)
        if angle not in self.angle_names[j]:
            raise InputError(f"joint angles: {joint} has no angle {angle!r}; it has: {choices(self.angle_names[j])}")
        a = self.angle_names[j].index(angle)
        rad, sigma_rad = self.angle_rad[:, 0, j, a], self.sigma_rad[:, 0, j, a]
        return AngleSeries(name=f"{joint} {angle}", t_s=self.t_ns * 1e-9, rad=rad, sigma_rad=sigma_rad)

    def of(self, person_id: int) -> Self:
        """The angles of one person; raises InputError for an id that is not there."""
        place = np.flatnonzero(self.person_id == person_id)
        if len(place) != 1:
            raise InputError(f"joint angles: no person {person_id}; there are: {choices(map(str, self.person_id))}")
        over_time = ("world_from_segment", "angle_rad", "sigma_rad")
        return replace(self, person_id=self.person_id[place], **taken(self, over_time, (slice(None), place)))


def angle_labels(joints: JointAngles, between: str) -> list[str]:
    """A name for each angle in the order of `angle_rad`: that of its joint, `between`, and its own."""
    return [f"{joint}{between}{name}" for joint, name in joints.angles]
