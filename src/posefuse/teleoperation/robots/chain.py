"""The moving part of an MJCF model: joints that move the end effectors, their Jacobians, and distances between its bodies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from posefuse.core import ConfigError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices

_MOST_PAIRS = 60


class Chain:
    """Kinematics of the robot in a MuJoCo model, in coordinates of the model's world. Has data of its own.

    Attributes:
        joints: (n,) ids. names: of them. qpos, dofs: (n,) addresses. arm: (n,) bool, False for joints of the mobile base.
        low, high: (n,) limits; infinite where there are none. home: (n,) comfortable posture. bodies: ids of the robot's bodies.

    Raises:
        ConfigError: no such site, or joints that are neither hinges nor slides.
    """

    def __init__(self, model: Any, sites: Sequence[str]) -> None:
        import mujoco

        self._mj, self.model, self._data = mujoco, model, mujoco.MjData(model)
        known = [model.site(i).name for i in range(model.nsite)]
        for site in sites:
            if site not in known:
                raise ConfigError(f"robot: no site {site!r} in the model; there are: {choices(filter(None, known))}")
        self._sites = [model.site(site).id for site in sites]
        chains = [_ancestors(model, int(model.site_bodyid[site])) for site in self._sites]
        joints = sorted({j for chain in chains for body in chain for j in _joints_of(model, body)})
        slide, hinge = int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)
        if not joints or any(int(model.jnt_type[j]) not in (slide, hinge) for j in joints):
            raise ConfigError(
                "robot: expected hinge and slide joints between the world and the sites; a free base cannot be driven"
            )
        self.joints = np.array(joints)
        self.names = [model.joint(j).name for j in joints]
        self.qpos, self.dofs = model.jnt_qposadr[self.joints], model.jnt_dofadr[self.joints]
        limited = model.jnt_limited[self.joints].astype(bool)
        self.low = np.where(limited, model.jnt_range[self.joints, 0], -np.inf)
        self.high = np.where(limited, model.jnt_range[self.joints, 1], np.inf)
        root = {int(model.jnt_bodyid[j]) for j in joints if int(model.jnt_type[j]) == slide}
        # a base is what slides, and what turns together with it
        self.arm = np.array([int(model.jnt_bodyid[j]) not in root for j in joints])
        if not self.arm.any():
            self.arm[:] = True
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, self._data, 0)
        self.home = np.array(self._data.qpos[self.qpos])
        self.bodies = _with_children(model, int(model.jnt_bodyid[joints[0]]))
        self._pairs = self._watched_pairs()
        self._shoulders = [
            next(b for b in reversed(chain) if any(j in joints and self.arm[joints.index(j)] for j in _joints_of(model, b)))
            for chain in chains
        ]
        self._lengths = [self._length(chain, s) for chain, s in zip(chains, self._shoulders, strict=True)]
        self.place(self.home)

    @property
    def hands(self) -> int:
        """How many end effectors."""
        return len(self._sites)

    def place(self, q: Array) -> None:
        """Put the joints (n,) in place."""
        self._data.qpos[self.qpos] = q
        self._mj.mj_kinematics(self.model, self._data)
        self._mj.mj_comPos(self.model, self._data)

    def end_effector(self, h: int) -> tuple[Array, Array]:
        """(3,) position and (4,) wxyz of a site."""
        wxyz = np.zeros(4)
        self._mj.mju_mat2Quat(wxyz, self._data.site_xmat[self._sites[h]])
        return self._data.site_xpos[self._sites[h]].copy(), wxyz

    def jacobians(self) -> list[Array]:
        """(6, n) of each site: position, and orientation scaled by 0.3 m."""
        found = []
        for site in self._sites:
            j = np.zeros((6, self.model.nv))
            self._mj.mj_jacSite(self.model, self._data, j[:3], j[3:], site)
            j[3:] *= 0.3
            found.append(j[:, self.dofs])
        return found

    def stretch(self) -> float:
        """Distance of end effector and shoulder as a share of the arm's length; the largest of all arms."""
        data = self._data
        return max(
            float(np.linalg.norm(data.site_xpos[site] - data.xpos[body])) / length
            for site, body, length in zip(self._sites, self._shoulders, self._lengths, strict=True)
        )

    def distances(self, least_m: float, watch_m: float, approach: float) -> tuple[Array, Array]:
        """Linear constraints rows @ dq >= bounds that keep pairs of bodies apart: (C, n), (C,)."""
        rows, bounds = [], []
        fromto, one, other = np.zeros(6), np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        for a, b in self._pairs:
            distance = self._mj.mj_geomDistance(self.model, self._data, a, b, watch_m, fromto)
            if distance >= watch_m or distance <= 0.0:
                # what overlaps from the start has no direction to part in
                continue
            normal = (fromto[3:] - fromto[:3]) / distance
            self._mj.mj_jac(self.model, self._data, one, None, fromto[:3], self.model.geom_bodyid[a])
            self._mj.mj_jac(self.model, self._data, other, None, fromto[3:], self.model.geom_bodyid[b])
            rows.append((normal @ (other - one))[self.dofs])
            bounds.append(-approach * (distance - least_m) if distance > least_m else 0.0)
        return (np.array(rows), np.array(bounds)) if rows else (np.zeros((0, len(self.dofs))), np.zeros(0))

    def spheres(self) -> Array:
        """(M, 4) centre and radius of spheres that cover the robot's geoms."""
        data, model = self._data, self.model
        found = []
        for g in range(model.ngeom):
            if int(model.geom_bodyid[g]) not in self.bodies:
                continue
            axis, half, radius = _spine(model, g, self._mj)
            direction = data.geom_xmat[g].reshape(3, 3)[:, axis]
            for place in np.linspace(-half, half, max(1, int(np.ceil(2 * half / max(radius, 0.02))) + 1)):
                found.append([*(data.geom_xpos[g] + place * direction), radius * 1.12])
        return np.array(found)

    def _length(self, chain: Sequence[int], shoulder: int) -> float:
        """Length of the chain from the shoulder to the end effector, link by link."""
        links = chain[: chain.index(shoulder)]
        return float(sum(np.linalg.norm(self.model.body_pos[body]) for body in links)) or 1.0

    def _watched_pairs(self) -> list[tuple[int, int]]:
        """Geoms of the robot that could touch: not of one body or of neighbours; the floor and all but the base."""
        model = self.model
        solid = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
        own = [g for g in solid if int(model.geom_bodyid[g]) in self.bodies]
        floor = [g for g in solid if int(model.geom_type[g]) == int(self._mj.mjtGeom.mjGEOM_PLANE) and model.geom_bodyid[g] == 0]
        order = {body: i for i, body in enumerate(self.bodies)}
        pairs = [
            (a, b)
            for i, a in enumerate(own)
            for b in own[i + 1 :]
            if order[int(model.geom_bodyid[b])] - order[int(model.geom_bodyid[a])] > 3
        ]
        moving = [g for g in own if order[int(model.geom_bodyid[g])] > 3]
        return [*pairs, *((f, g) for f in floor for g in moving)][:_MOST_PAIRS]


def _spine(model: Any, g: int, mj: Any) -> tuple[int, float, float]:
    """Axis, half length and radius of a row of spheres that covers a geom."""
    size = model.geom_size[g]
    kind = int(model.geom_type[g])
    if kind in (int(mj.mjtGeom.mjGEOM_CAPSULE), int(mj.mjtGeom.mjGEOM_CYLINDER)):
        return 2, float(size[1]), float(size[0])
    if kind == int(mj.mjtGeom.mjGEOM_BOX):
        axis = int(np.argmax(size))
        across = float(np.linalg.norm(np.delete(size, axis)))
        return axis, max(float(size[axis]) - across / 2, 0.0), across
    return 2, 0.0, float(model.geom_rbound[g])


def _joints_of(model: Any, body: int) -> range:
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body])) if first >= 0 else range(0)


def _ancestors(model: Any, body: int) -> list[int]:
    """The body, its parent, and so on, without the world."""
    found = []
    while body:
        found.append(body)
        body = int(model.body_parentid[body])
    return found


def _with_children(model: Any, root: int) -> list[int]:
    """All bodies of the tree below `root`, parents first."""
    found = [root]
    for body in range(root + 1, model.nbody):
        if int(model.body_parentid[body]) in found:
            found.append(body)
    return found
