"""Joint angles as tables and curves."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from posefuse import core

from .arguments import html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame
    from xarray import Dataset


class JointAngles(core.JointAngles):
    """Joint angles of a recording; all of `core.JointAngles`, and what one does with it.

    Examples:
        >>> import posefuse as pf
        >>> angles = pf.read("RESULT").joint_angles()  # doctest: +SKIP
        >>> angles["left_knee", "flexion"].deg.max()  # doctest: +SKIP
        >>> angles.to_dataframe().groupby(["joint", "angle"]).deg.max()  # doctest: +SKIP
    """

    def _repr_html_(self) -> str:
        names = [(joint, name) for joint, three in zip(self.joints, self.angle_names, strict=True) for name in three]
        known = zip(names, self.angle_rad.reshape(-1, len(names)).T, strict=True)
        rows = [
            (joint, name, f"{np.degrees(np.nanmin(rad)):.1f}", f"{np.degrees(np.nanmax(rad)):.1f}")
            for (joint, name), rad in known
            if np.isfinite(rad).any()
        ]
        return html_table(repr(self), ("joint", "angle", "least deg", "greatest deg"), rows)

    def to_xarray(self) -> Dataset:
        """Angles and their standard deviations in radians, axes time, person, angle; needs the extra ``data``."""
        from posefuse.formats.labelled import angles_to_xarray

        return angles_to_xarray(self)

    def to_dataframe(self) -> DataFrame:
        """One row per time step, person and angle: time_s, person, joint, angle, deg, sigma_deg; needs the extra ``data``."""
        from posefuse.formats.labelled import angles_to_dataframe

        return angles_to_dataframe(self)

    def plot(self, joint: str, angle: str, *, axes: Axes | None = None) -> Axes:
        """Draw one angle in degrees over time with a band of two standard deviations; needs the extra ``data``.

        Raises:
            InputError: no such joint or angle, or several people: select one with `of`.
        """
        from posefuse.outputs.plots import plot_angle

        return plot_angle(self[joint, angle], axes)


def joint_angles_of(value: core.JointAngles) -> JointAngles:
    """The same angles as those of the public interface."""
    return JointAngles(**{field.name: getattr(value, field.name) for field in fields(core.JointAngles)})
