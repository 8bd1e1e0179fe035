"""Results as labelled arrays (xarray), which go to netCDF and back, and as tables (pandas).

Dimensions: time (seconds, float64; the exact nanoseconds are the coordinate ``t_ns``), person (id), keypoint (name), space
("x", "y", "z"; world frame, Z up), space_b (the columns of a covariance), camera (name) and angle ("left_knee flexion").
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from posefuse.core import InputError, JointAngles, Recording
from posefuse.core.arrays import Array
from posefuse.core.extras import package_of_extra
from posefuse.core.joint_angles import angle_labels
from posefuse.core.poses import point_sigma_m

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

SPACE = ("x", "y", "z")
_POINT = ("time", "person", "keypoint")
# PoseSequence field -> (variable, dimensions, units, meaning)
_VARIABLES = {
    "xyz_world": ("position", (*_POINT, "space"), "m", "keypoint in the world frame, Z up"),
    "cov_world": ("covariance", (*_POINT, "space", "space_b"), "m2", "covariance of the position"),
    "reproj_px": ("reprojection_error", _POINT, "px", "rms distance of the views used to the reprojection"),
    "n_views": ("n_views", _POINT, "1", "cameras used"),
    "kind": ("kind", _POINT, "1", "0 missing, 1 fused, 2 smoothed, 3 interpolated, 4 predicted"),
}


def recording_to_xarray(recording: Recording, angles: JointAngles | None = None) -> Dataset:
    """Positions with their covariance, and the joint angles where they are given, as one Dataset.

    Units are in the attributes of every variable; skeleton, rig id and provenance (as JSON) in those of the Dataset.

    Raises:
        InputError: angles of other people or time steps than the recording.
    """
    xr = package_of_extra("xarray", "data")
    poses = recording.poses
    data: dict[str, Any] = {
        name: (dims, getattr(poses, field), {"units": units, "long_name": meaning})
        for field, (name, dims, units, meaning) in _VARIABLES.items()
    }
    coords: dict[str, Any] = {
        **_time_and_person(poses.t_ns, poses.person_id),
        "keypoint": list(poses.skeleton.keypoints),
        "space": list(SPACE),
        "space_b": list(SPACE),
    }
    if angles is not None:
        if not (np.array_equal(angles.t_ns, poses.t_ns) and np.array_equal(angles.person_id, poses.person_id)):
            raise InputError("to_xarray: the joint angles are not those of this recording")
        coords["angle"] = angle_labels(angles, " ")
        data |= _angle_variables(angles)
    attrs = {
        "source": "posefuse",
        "rig_id": recording.rig.id,
        "cameras": list(recording.rig.names),
        "skeleton": poses.skeleton.name,
        "bones": json.dumps([list(bone) for bone in poses.skeleton.bones]),
        "provenance": json.dumps(dict(recording.provenance)),
    }
    dataset: Dataset = xr.Dataset(data, coords=coords, attrs=attrs)
    return dataset


def _time_and_person(t_ns: Array, person_id: Array) -> dict[str, Any]:
    return {
        "time": ("time", t_ns * 1e-9, {"units": "s", "long_name": "session seconds"}),
        "t_ns": ("time", t_ns, {"units": "ns", "long_name": "session clock, mid-exposure"}),
        "person": person_id,
    }


def _angle_variables(angles: JointAngles) -> dict[str, Any]:
    dims, shape = ("time", "person", "angle"), (len(angles), len(angles.person_id), 3 * len(angles.joints))
    return {
        "joint_angle": (dims, angles.angle_rad.reshape(shape), {"units": "rad", "long_name": "joint angle"}),
        "joint_angle_sigma": (dims, angles.sigma_rad.reshape(shape), {"units": "rad", "long_name": "its standard deviation"}),
    }


def angles_to_xarray(angles: JointAngles) -> Dataset:
    """Joint angles and their standard deviations as a Dataset with the names and units of `recording_to_xarray`."""
    coords = _time_and_person(angles.t_ns, angles.person_id) | {"angle": angle_labels(angles, " ")}
    dataset: Dataset = package_of_extra("xarray", "data").Dataset(_angle_variables(angles), coords=coords)
    return dataset


def angles_to_dataframe(angles: JointAngles) -> DataFrame:
    """One row per time step, person and angle: time_s, person, joint, angle, deg, sigma_deg."""
    t, n = angles.angle_rad.shape[:2]
    each = angles.angles
    table: DataFrame = package_of_extra("pandas", "data").DataFrame(
        {
            "time_s": np.repeat(angles.t_ns * 1e-9, n * len(each)),
            "person": np.tile(np.repeat(angles.person_id, len(each)), t),
            "joint": [joint for joint, _ in each] * (t * n),
            "angle": [name for _, name in each] * (t * n),
            "deg": np.degrees(angles.angle_rad).ravel(),
            "sigma_deg": np.degrees(angles.sigma_rad).ravel(),
        }
    )
    return table


def recording_to_dataframe(recording: Recording) -> DataFrame:
    """One row per time step, person and keypoint.

    Columns: time_s, person, keypoint, x_m, y_m, z_m, sigma_m (root of the mean variance of the axes), reproj_px, n_views, kind.
    """
    pd = package_of_extra("pandas", "data")
    poses = recording.poses
    t, n, k = poses.kind.shape
    xyz = poses.xyz_world.reshape(-1, 3)
    return pd.DataFrame(
        {
            "time_s": np.repeat(poses.t_ns * 1e-9, n * k),
            "person": np.tile(np.repeat(poses.person_id, k), t),
            "keypoint": pd.Categorical(np.tile(np.array(poses.skeleton.keypoints), t * n), categories=poses.skeleton.keypoints),
            "x_m": xyz[:, 0],
            "y_m": xyz[:, 1],
            "z_m": xyz[:, 2],
            "sigma_m": point_sigma_m(poses.cov_world).ravel(),
            "reproj_px": poses.reproj_px.ravel(),
            "n_views": poses.n_views.ravel(),
            "kind": poses.kind.ravel(),
        }
    )
