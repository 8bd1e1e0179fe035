"""Kinematics of the robot in an MJCF model, and differential inverse kinematics of its whole body.

The inverse kinematics is one quadratic program per control step. Unknowns are the steps of all joints that move an end effector.
Minimised are the errors of the end effectors, then (weakly) the distance from a comfortable posture and the motion of the base;
constraints are joint limits with a margin, speed and acceleration of the joints, and distances between
the own bodies of the robot. The formulation is the usual one (Escande et al. 2014; the linearised distances after Faverjon and
Tournassoud 1987); the program is solved by DAQP (Arnström et al. 2022).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from posefuse.core import ConfigError
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.core.extras import package_of_extra

from .mapping import rotvec_between
from .settings import SLOW_CONDITION, STOP_CONDITION, LimitSettings


class Chain:
    """Kinematics of the robot in a MuJoCo model, in coordinates of the model's world. Has data of its own.

    Attributes:
        joints: (n,) ids. names: of them. qpos, dofs: (n,) addresses. arm: (n,) bool, False for joints of the mobile base.
        low, high: (n,) limits; infinite where there are none. home: (n,) comfortable posture. bodies: ids of the robot's bodies.
        pairs: (P, 2) geoms that could touch: of the robot, and of the robot and the floor. Not those of bodies that share a
            joint, that the model excludes from contact, or that are nearer than `apart_m` in its home posture.

    Raises:
        ConfigError: no such site, or joints that are neither hinges nor slides.
    """

    def __init__(self, model: Any, sites: Sequence[str], apart_m: float) -> None:
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
        self._base = root = {int(model.jnt_bodyid[j]) for j in joints if int(model.jnt_type[j]) == slide}
        # a base is what slides, and what turns together with it
        self.arm = np.array([int(model.jnt_bodyid[j]) not in root for j in joints])
        if not self.arm.any():
            self.arm[:] = True
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, self._data, 0)
        self.home = np.array(self._data.qpos[self.qpos])
        # what stands in the world below the first joint is the robot, too
        self.bodies = _with_children(model, {chain[-1] for chain in chains})
        self._shoulders = [
            next(b for b in reversed(chain) if any(j in joints and self.arm[joints.index(j)] for j in _joints_of(model, b)))
            for chain in chains
        ]
        self._lengths = [self._length(chain, s) for chain, s in zip(chains, self._shoulders, strict=True)]
        self._balls = _balls(model, self.bodies, mujoco)
        self.place(self.home)
        self.pairs = self._watched_pairs(apart_m)
        self._reach = np.array([[self._far(int(j), *pair) for j in self.joints] for pair in self.pairs]).reshape(-1, len(joints))

    @property
    def hands(self) -> int:
        """How many end effectors."""
        return len(self._sites)

    def place(self, q: Array) -> None:
        """Put the joints (n,) in place."""
        self._data.qpos[self.qpos] = q
        self._mj.mj_kinematics(self.model, self._data)

    def positions(self) -> Array:
        """(H, 3) of the end effectors."""
        return np.asarray(self._data.site_xpos[self._sites])

    def orientations(self) -> Array:
        """(H, 4) wxyz of the end effectors."""
        found = np.zeros((self.hands, 4))
        for h, site in enumerate(self._sites):
            self._mj.mju_mat2Quat(found[h], self._data.site_xmat[site])
        return found

    def jacobians(self) -> Array:
        """(H, 6, n) of each site: position, m, above orientation, rad."""
        found = np.zeros((self.hands, 6, self.model.nv))
        self._mj.mj_comPos(self.model, self._data)
        for h, site in enumerate(self._sites):
            self._mj.mj_jacSite(self.model, self._data, found[h, :3], found[h, 3:], site)
        return np.asarray(found[:, :, self.dofs])

    def stretch(self) -> float:
        """Distance of end effector and shoulder as a share of the arm's length; the largest of all arms."""
        data = self._data
        return max(
            float(np.linalg.norm(data.site_xpos[site] - data.xpos[body])) / length
            for site, body, length in zip(self._sites, self._shoulders, self._lengths, strict=True)
        )

    def distances(self, watch_m: float) -> Array:
        """(P,) distance of each pair, negative where it overlaps; `watch_m` where it is farther apart than that."""
        found = np.full(len(self.pairs), watch_m)
        for i in self._near(watch_m):
            a, b = self.pairs[i]
            found[i] = self._mj.mj_geomDistance(self.model, self._data, a, b, watch_m, None)
        return found

    def gaps(self, watch_m: float) -> tuple[Array, Array]:
        """(C,) distances of the pairs nearer than `watch_m`, negative where they overlap; (C, n) their change per joint step."""
        distances, rows = [], []
        self._mj.mj_comPos(self.model, self._data)
        fromto, one, other = np.zeros(6), np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        for i in self._near(watch_m):
            a, b = self.pairs[i]
            distance = self._mj.mj_geomDistance(self.model, self._data, a, b, watch_m, fromto)
            if distance >= watch_m or abs(distance) < 1e-9:
                continue
            normal = (fromto[3:] - fromto[:3]) / distance
            self._mj.mj_jac(self.model, self._data, one, None, fromto[:3], self.model.geom_bodyid[a])
            self._mj.mj_jac(self.model, self._data, other, None, fromto[3:], self.model.geom_bodyid[b])
            distances.append(float(distance))
            rows.append((normal @ (other - one))[self.dofs])
        return np.array(distances), np.array(rows).reshape(-1, len(self.joints))

    def travel_m(self, step: Array) -> Array:
        """(P,) by how much a joint step (n,) changes the distance of each pair at most."""
        return np.asarray(self._reach @ np.abs(step))

    def spheres(self) -> Array:
        """(M, 4) centre and radius of spheres that cover the robot's geoms."""
        geom, local, radius = self._balls
        turned = np.einsum("mij,mj->mi", self._data.geom_xmat[geom].reshape(-1, 3, 3), local)
        return np.column_stack([self._data.geom_xpos[geom] + turned, radius])

    def _near(self, watch_m: float) -> Array:
        """Pairs whose bounding spheres are nearer than `watch_m`."""
        data, model = self._data, self.model
        apart = data.geom_xpos[self.pairs[:, 1]] - data.geom_xpos[self.pairs[:, 0]]
        radius = model.geom_rbound[self.pairs].sum(axis=1)
        # a plane has no radius; its normal is its z axis
        plane = self._plane
        distance = np.where(
            plane, (apart * data.geom_xmat[self.pairs[:, 0]][:, 2::3]).sum(axis=1), np.sqrt((apart * apart).sum(axis=1))
        )
        return np.asarray(np.flatnonzero(distance - radius < watch_m))

    def _length(self, chain: Sequence[int], shoulder: int) -> float:
        """Length of the chain from the shoulder to the end effector, link by link."""
        links = chain[: chain.index(shoulder)]
        return float(sum(np.linalg.norm(self.model.body_pos[body]) for body in links)) or 1.0

    def _far(self, joint: int, a: int, b: int) -> float:
        """How far a joint moves two geoms against each other at most, m per unit: the moved one's distance from its axis."""
        model, top = self.model, int(self.model.jnt_bodyid[joint])
        moved = [g for g in (a, b) if top in _ancestors(model, int(model.geom_bodyid[g]))]
        if len(moved) != 1:
            return 0.0
        if int(model.jnt_type[joint]) == int(self._mj.mjtJoint.mjJNT_SLIDE):
            return 1.0
        chain = _ancestors(model, int(model.geom_bodyid[moved[0]]))
        links = chain[: chain.index(top)]
        parts = [model.jnt_pos[joint], model.geom_pos[moved[0]], *(model.body_pos[body] for body in links)]
        return float(sum(np.linalg.norm(part) for part in parts) + model.geom_rbound[moved[0]])

    def _watched_pairs(self, apart_m: float) -> Array:
        """See `pairs`; the floor is a plane of the world, and comes first in its pairs."""
        model = self.model
        solid = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
        own = [g for g in solid if int(model.geom_bodyid[g]) in self.bodies]
        is_plane = model.geom_type == int(self._mj.mjtGeom.mjGEOM_PLANE)
        floor = [g for g in solid if is_plane[g] and int(model.geom_bodyid[g]) == 0]
        # a base that slides over the floor keeps its distance
        lifted = [g for g in own if int(model.geom_bodyid[g]) not in self._base]
        could = [(f, g) for f in floor for g in lifted] + [(a, b) for i, a in enumerate(own) for b in own[i + 1 :]]
        could = [pair for pair in could if self._may_touch(*pair)]
        self.pairs = np.array(could, int).reshape(-1, 2)
        self._plane = is_plane[self.pairs[:, 0]]
        apart = self.distances(1.0) > apart_m
        self._plane = self._plane[apart]
        return self.pairs[apart]

    def _may_touch(self, a: int, b: int) -> bool:
        """MuJoCo's own rule for contacts: masks, exclusions, and bodies that move together or share a joint."""
        model = self.model
        masks = model.geom_contype[a] & model.geom_conaffinity[b] or model.geom_contype[b] & model.geom_conaffinity[a]
        one, other = sorted(int(model.geom_bodyid[g]) for g in (a, b))
        left, right = int(model.body_weldid[one]), int(model.body_weldid[other])
        up, down = (int(model.body_weldid[int(model.body_parentid[body])]) for body in (left, right))
        related = left == right or (left and up == right) or (right and down == left and left)
        return bool(masks) and not related and (one << 16) + other not in model.exclude_signature


def _balls(model: Any, bodies: Sequence[int], mj: Any) -> tuple[Array, Array, Array]:
    """Spheres that cover the geoms of bodies: (M,) geom, (M, 3) centre in its axes, (M,) radius."""
    geoms, centres, radii = [], [], []
    for g in range(model.ngeom):
        if int(model.geom_bodyid[g]) not in bodies:
            continue
        axis, half, radius = _spine(model, g, mj)
        for place in np.linspace(-half, half, max(1, int(np.ceil(2 * half / max(radius, 0.02))) + 1)):
            geoms.append(g)
            centres.append(place * np.eye(3)[axis])
            radii.append(radius * 1.12)
    return np.array(geoms, int), np.array(centres).reshape(-1, 3), np.array(radii)


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


def _with_children(model: Any, roots: set[int]) -> list[int]:
    """All bodies of the trees below `roots`, parents first."""
    found = set(roots)
    for body in range(1, model.nbody):
        if int(model.body_parentid[body]) in found:
            found.add(body)
    return sorted(found)


# weights: errors count per m^2 and, by this length, per rad^2
_TURN_LENGTH_M = 0.3
_DAMPING, _BASE_DAMPING, _POSTURE = 1e-6, 3e-4, 2e-5
_POSTURE_PER_S = 0.5
# the arm works alone while it is stretched to between the inner shares of its length; from the outer ones on the base is free
_FOLDED, _COMFORTABLE, _STRETCHED = (0.3, 0.4), 0.5, 0.62
# share of the speed limit that a singularity leaves
_SLOWEST = 0.1
# a pair of bodies nearer than this is watched
_WATCH_M = 0.2


class WholeBodyIk:
    """Joint steps for poses of the end effectors.

    Attributes:
        chain: the robot. comfort: (n,) posture that it tends to. condition: of the arms' Jacobian before the last `step`.
        speed, acceleration, low, high: (n,) limits of the joints, with the margin.

    Raises:
        ConfigError: limits for another number of joints.
    """

    def __init__(self, chain: Chain, limits: LimitSettings) -> None:
        self._daqp = package_of_extra("daqp", "teleop")
        self.chain, self._limits = chain, limits
        self.comfort = chain.home.copy()
        self.condition = 1.0
        self.speed = _per_joint(chain, "joint_speed_radps", limits.joint_speed_radps, limits.base_speed_mps)
        self.acceleration = _per_joint(
            chain, "joint_acceleration_radps2", limits.joint_acceleration_radps2, limits.base_acceleration_mps2
        )
        margin = np.where(chain.arm, limits.joint_margin_rad, 0.0)
        self.low, self.high = chain.low + margin, chain.high - margin

    def step(self, q: Array, last: Array, xyz: Array, wxyz: Array, dt_s: float) -> Array | None:
        """(n,) joint step from `q` after the step `last` that brings the end effectors to (H, 3), (H, 4); None: no solution."""
        chain = self.chain
        chain.place(q + last)
        ahead = chain.positions()
        chain.place(q)
        jacobians, here, turned = chain.jacobians(), chain.positions(), chain.orientations()
        # the path of an end effector is curved, and about as much in this step as in the last one
        curve = ahead - here - jacobians[:, :3] @ last
        self.condition = max(_condition(_scaled(j)[:, chain.arm]) for j in jacobians)
        weight, target = np.diag(np.where(chain.arm, _DAMPING, _BASE_DAMPING)), np.zeros(len(q))
        for h, j in enumerate(jacobians):
            error = np.concatenate([xyz[h] - here[h] - curve[h], _TURN_LENGTH_M * rotvec_between(turned[h], wxyz[h])])
            scaled = _scaled(j)
            weight += scaled.T @ scaled
            target += scaled.T @ error
        pull = np.where(chain.arm, _POSTURE_PER_S * dt_s * (self.comfort - q), 0.0)
        weight += np.diag(np.where(chain.arm, _POSTURE, 0.0))
        target += _POSTURE * pull
        low, high = self._bounds(q, last, dt_s)
        rows, least = self._apart(last, dt_s)
        upper = np.concatenate([high, np.full(len(least), 1e30)])
        found = self._daqp.solve(weight, -target, rows, upper, np.concatenate([low, least]))
        if found[2] < 1 or not np.isfinite(found[0]).all():
            return None
        return np.asarray(np.clip(found[0], low, high))

    def pace(self) -> float:
        """Share of the speed limit: falls with the condition number, never to nothing, so that a singularity can be left."""
        share = (STOP_CONDITION - self.condition) / (STOP_CONDITION - SLOW_CONDITION)
        return float(np.clip(share, _SLOWEST, 1.0))

    def singular(self) -> float:
        """Condition number of the arms' Jacobian as the chain is placed now."""
        return max(_condition(_scaled(j)[:, self.chain.arm]) for j in self.chain.jacobians())

    def _base_share(self) -> float:
        """How freely the base may move, 0..1: not at all while the arm is comfortable."""
        stretch = self.chain.stretch()
        far = (stretch - _COMFORTABLE) / (_STRETCHED - _COMFORTABLE)
        near = (_FOLDED[1] - stretch) / (_FOLDED[1] - _FOLDED[0])
        return float(np.clip(max(far, near), 0.0, 1.0))

    def _bounds(self, q: Array, last: Array, dt_s: float) -> tuple[Array, Array]:
        """Least and most step of each joint. One that is past its limit may come back only."""
        arm, change = self.chain.arm, self.acceleration * dt_s**2
        speed = dt_s * self.speed * (1.0 if arm.all() else np.where(arm, 1.0, self._base_share()))
        up = np.minimum(speed, _braking_step(self.high - q, change))
        down = np.minimum(speed, _braking_step(q - self.low, change))
        return np.clip(-down, last - change, last + change), np.clip(up, last - change, last + change)

    def _apart(self, last: Array, dt_s: float) -> tuple[Array, Array]:
        """Linear constraints rows @ step >= least that keep pairs of bodies apart: (C, n), (C,)."""
        distances, rows = self.chain.gaps(_WATCH_M)
        # a stop ends all joints together: links come nearer for as long as the slowest to brake needs, e.g. the base
        steps = float((np.abs(last) / self.acceleration).max()) / dt_s**2 / 2
        return rows, -np.maximum(distances - self._limits.collision_m, 0.0) / (1 + steps)


def _per_joint(chain: Chain, name: str, arm: float | tuple[float, ...], base: float) -> Array:
    """(n,) a limit of the arm's joints, one for all or one each, and of the base."""
    count = int(chain.arm.sum())
    if isinstance(arm, tuple) and len(arm) != count:
        raise ConfigError(f"limits.{name}: expected one value, or {count} for the joints of the robot's arms; got {len(arm)}")
    found = np.full(len(chain.arm), base)
    found[chain.arm] = arm
    return found


def _braking_step(left: Array, change: Array | float) -> Array:
    """Largest step towards a limit that is `left` away, if each step may be smaller by `change` than the one before."""
    return np.asarray(np.sqrt(change * change + 2 * change * np.maximum(left, 0.0)) - change)


def _scaled(jacobian: Array) -> Array:
    """A Jacobian (6, n) whose rows of orientation are lengths."""
    return np.concatenate([jacobian[:3], _TURN_LENGTH_M * jacobian[3:]])


def _condition(jacobian: Array) -> float:
    values = np.linalg.svd(jacobian, compute_uv=False)
    return float(values[0] / max(values[-1], 1e-9))
