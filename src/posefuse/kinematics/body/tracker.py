"""The causal whole-body fit of live poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from posefuse.core import InputError, JointAngles, Kind, Pose3D, Rig, Skeleton, Views
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.kinematics.definitions import JOINT_NAMES
from posefuse.kinematics.joints import FrameBuffers, frames_of, joints_value
from posefuse.kinematics.settings import JointSettings

from .filter import BodyFilter, Measurement
from .model import BodyModel
from .result import StateReader, empty_joints
from .settings import BodySettings


class BodyTracker:
    """Fits known bodies to poses or views as they come. Remembers each body's motion; see `BodyFilter`.

    Args:
        bodies: by person_id, all of one skeleton, from `bodies_from_poses`.
        rig: needed by `step_views` only.
    """

    def __init__(
        self,
        bodies: Mapping[int, BodyModel],
        settings: BodySettings | None = None,
        joint_settings: JointSettings | None = None,
        rig: Rig | None = None,
    ) -> None:
        if not bodies:
            raise InputError("BodyTracker: expected at least one body, got none; make them with bodies_from_poses")
        self._skeleton: Skeleton = next(iter(bodies.values())).skeleton
        work = FrameBuffers(self._skeleton, joint_settings or JointSettings())
        self._filters = {p: BodyFilter(body, settings or BodySettings(), work) for p, body in bodies.items()}
        self._readers = {p: StateReader(filter_, work) for p, filter_ in self._filters.items()}
        self._rig = rig
        self._projections = rig.projections() if rig else np.zeros((0, 3, 4))

    def step(self, pose: Pose3D) -> tuple[Pose3D, JointAngles]:
        """Pose and joints of one time step, each person's points fitted by their covariance.

        People without a body keep their points and have no angles. Raises InputError for another skeleton.
        """
        self._check(pose.skeleton)
        none = np.zeros((0, 3, 4))
        measured = {}
        for n, person in enumerate(pose.person_id.tolist()):
            if person in self._filters:
                at = self._filters[person].body.keypoint
                empty = np.zeros((len(at), 0))
                measured[n] = Measurement(
                    t_ns=pose.t_ns,
                    xyz=pose.xyz_world[n, at],
                    cov=pose.cov_world[n, at],
                    projections=none,
                    xy=empty[..., None] + [0, 0],
                    inverse_var=empty,
                )
        return self._stepped(pose, measured)

    def step_views(self, pose: Pose3D, views: Views) -> tuple[Pose3D, JointAngles]:
        """As `step`, fitted directly to the rays of all views of the same people; `pose` is where a start is guessed from.

        Raises:
            InputError: no rig was given, or the views are of other cameras or people than rig and pose.
        """
        self._check(views.skeleton)
        if self._rig is None or views.camera_names != self._rig.names or not np.array_equal(views.person_id, pose.person_id):
            have = choices(self._rig.names) if self._rig else "no rig"
            raise InputError(
                f"BodyTracker.step_views: expected views of the people of the pose by the cameras of the rig ({have}), "
                f"got cameras {choices(views.camera_names)}"
            )
        measured = {}
        for n, person in enumerate(pose.person_id.tolist()):
            if person in self._filters:
                at = self._filters[person].body.keypoint
                xy, inverse_var = rays_of(self._rig, views.xy_img[n][:, at], views.score[n][:, at], views.sigma_px[n][:, at])
                measured[n] = Measurement(
                    t_ns=pose.t_ns,
                    xyz=pose.xyz_world[n, at],
                    cov=pose.cov_world[n, at],
                    projections=self._projections,
                    xy=xy,
                    inverse_var=inverse_var,
                )
        return self._stepped(pose, measured)

    def _check(self, skeleton: Skeleton) -> None:
        if skeleton != self._skeleton:
            raise InputError(f"BodyTracker: expected skeleton {self._skeleton.name}, got {skeleton.name}")

    def _stepped(self, pose: Pose3D, measured: Mapping[int, Measurement]) -> tuple[Pose3D, JointAngles]:
        xyz, cov, kind = pose.xyz_world.copy(), pose.cov_world.copy(), pose.kind.copy()
        rotation, origin, angles, sigmas = empty_joints(1, len(pose.person_id), len(JOINT_NAMES))
        for n, seen in measured.items():
            person = int(pose.person_id[n])
            moment = self._filters[person].step(seen)
            if moment is None:
                continue
            fitted = self._readers[person].read(moment.state)
            at = self._filters[person].body.keypoint
            xyz[n, at], cov[n, at] = fitted.xyz, fitted.cov
            kind[n, at] = np.where(np.isfinite(seen.xyz[:, 0]), Kind.SMOOTHED, Kind.PREDICTED)
            rotation[0, n], origin[0, n] = fitted.rotation, fitted.origin
            angles[0, n], sigmas[0, n] = fitted.angles, fitted.sigmas
        out = replace(pose, xyz_world=xyz, cov_world=cov, kind=kind)
        return out, joints_value(np.array([pose.t_ns]), pose.person_id, *frames_of(rotation, origin), angles, sigmas)


def rays_of(rig: Rig, xy_img: Array, score: Array, sigma_px: Array) -> tuple[Array, Array]:
    """Undistorted pixels (A, C, 2) and 1 / sigma^2 (A, C), 0 where unseen, of views (C, A, ...)."""
    seen = (score > 0) & np.isfinite(xy_img).all(axis=-1) & (sigma_px > 0)
    xy = np.stack([camera.undistort(xy_img[c]) for c, camera in enumerate(rig)])
    seen &= np.isfinite(xy).all(axis=-1)
    inverse_var = np.where(seen, 1.0 / np.where(seen, sigma_px, 1.0) ** 2, 0.0)
    return np.ascontiguousarray(np.swapaxes(np.where(seen[..., None], xy, 0.0), 0, 1)), np.ascontiguousarray(inverse_var.T)
