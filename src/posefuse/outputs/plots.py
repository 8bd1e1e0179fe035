"""Curves of a recording drawn with matplotlib; every function returns the axes that it drew into."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from posefuse.core import AngleSeries, InputError, Recording
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.core.extras import package_of_extra

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_AXIS_NAMES = ("x", "y", "z")
_BAND_SIGMAS = 2.0


def plot_keypoint(
    recording: Recording, keypoint: str, person_id: int | None = None, axes: Sequence[Axes] | None = None
) -> list[Axes]:
    """Position of a keypoint over time, an axes for each of x, y and z in metres, with a band of two standard deviations.

    Args:
        recording: what to draw. keypoint: a name of its skeleton. person_id: left out where there is one person.
        axes: three axes to draw into; new ones when left out.

    Raises:
        InputError: no such keypoint or person, or not three axes.
    """
    poses = recording.poses
    if keypoint not in poses.skeleton.keypoints:
        raise InputError(f"no keypoint {keypoint!r}; there are: {choices(poses.skeleton.keypoints)}")
    k, n = poses.skeleton.index(keypoint), person_place(recording, person_id)
    drawn = list(axes) if axes is not None else _new_axes(3)
    if len(drawn) != 3:
        raise InputError(f"plot: expected 3 axes (x, y, z), got {len(drawn)}")
    t_s = poses.t_ns * 1e-9
    sigma = np.sqrt(np.diagonal(poses.cov_world[:, n, k], axis1=-2, axis2=-1))
    for a, (name, one) in enumerate(zip(_AXIS_NAMES, drawn, strict=True)):
        _curve(one, t_s, poses.xyz_world[:, n, k, a], sigma[:, a], keypoint.replace("_", " "))
        one.set_ylabel(f"{name} [m]")
    drawn[-1].set_xlabel("time [s]")
    drawn[0].set_title(keypoint.replace("_", " "))
    return drawn


def plot_angle(series: AngleSeries, axes: Axes | None = None) -> Axes:
    """One joint angle over time in degrees, with a band of two standard deviations."""
    one = axes if axes is not None else _new_axes(1)[0]
    _curve(one, series.t_s, series.deg, series.sigma_deg, series.name.replace("_", " "))
    one.set_xlabel("time [s]")
    one.set_ylabel("angle [deg]")
    one.set_title(series.name.replace("_", " "))
    return one


def person_place(recording: Recording, person_id: int | None) -> int:
    """Place on axis N of a person; with None, of the only one.

    Raises:
        InputError: no such person, or None where there are several.
    """
    ids = recording.poses.person_id.tolist()
    if person_id is None and len(ids) == 1:
        return 0
    if person_id not in ids:
        wanted = "person: choose one of several" if person_id is None else f"no person {person_id}"
        raise InputError(f"{wanted}; there are: {choices(map(str, ids))}")
    return int(ids.index(person_id))


def _curve(axes: Axes, t_s: Array, values: Array, sigma: Array, label: str) -> None:
    (line,) = axes.plot(t_s, values, label=label, linewidth=1.5)
    band = _BAND_SIGMAS * sigma
    axes.fill_between(t_s, values - band, values + band, color=line.get_color(), alpha=0.2, linewidth=0)
    # wide bands of badly determined angles must not flatten the curve
    known = values[np.isfinite(values)]
    if len(known):
        room = max(0.6 * float(np.ptp(known)), 1e-3)
        low, high = float(known.min()) - room, float(known.max()) + room
        now = axes.get_ylim() if len(axes.lines) > 1 else (low, high)
        axes.set_ylim(min(low, now[0]), max(high, now[1]))
    axes.grid(True, alpha=0.3)


def _new_axes(count: int) -> list[Any]:
    _, axes = package_of_extra("matplotlib.pyplot", "data").subplots(
        count, 1, sharex=True, figsize=(8, 2.4 * count if count > 1 else 3.6), layout="constrained", squeeze=False
    )
    return list(axes[:, 0])
