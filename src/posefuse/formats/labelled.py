"""Results as tables (pandas)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from posefuse.core import JointAngles, Recording
from posefuse.core.extras import package_of_extra
from posefuse.core.poses import point_sigma_m

if TYPE_CHECKING:
    from pandas import DataFrame


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
