"""Angles of the report: over time, over the gait cycle, and their ranges."""

from __future__ import annotations

import numpy as np

from posefuse.core import JointAngles
from posefuse.evaluation.gait_cycles import HEADING, PERCENT, CycleAngles, side_of
from posefuse.formats.page import Band, Cell, Line, Plot, Series, Table, Ticks
from posefuse.kinematics.gait import Gait

_SHARE_DRAWN = 0.02
# single strides drawn per side; all of them are in gait_cycles.csv
_MOST_CYCLES = 10
_SIDES = ("left", "right")
_FIRST = ("pelvis", "hip", "knee", "ankle")


def title_of(joint: str, angle: str) -> str:
    """The same for left and right: ``Knee flexion``."""
    part = joint.removeprefix("left_").removeprefix("right_")
    return f"{part} {angle}".replace("_", " ").capitalize()


def rank_of(joint: str) -> int:
    """The place of a joint in the report: pelvis and legs come first."""
    part = joint.removeprefix("left_").removeprefix("right_")
    return _FIRST.index(part) if part in _FIRST else len(_FIRST)


def time_plots(joints: JointAngles, person: int, gait: Gait | None, band_sigmas: float) -> list[Plot]:
    """One plot per angle, left and right together, with bands of the stated uncertainty."""
    t_s = (joints.t_ns - joints.t_ns[:1]) * 1e-9
    strikes = [Ticks(f"{side} foot strike", times, colour=side) for side, times in (gait.strike_s if gait else {}).items()]
    plots = []
    for title, members in _grouped(joints).items():
        series: list[Series] = []
        for q, a in members:
            values = np.degrees(joints.angle_rad[:, person, q, a])
            if np.isfinite(values).mean() > _SHARE_DRAWN:
                side, band = side_of(joints.joints[q]), band_sigmas * np.degrees(joints.sigma_rad[:, person, q, a])
                series.append(Band(f"{side} ± {band_sigmas:g} sd", t_s, values - band, values + band, colour=side))
                series.append(Line(side if side in _SIDES else "trunk", t_s, values, colour=side))
        if series:
            plots.append(Plot(title, [*series, *strikes], x_label="s", y_label="degrees", legend=False))
    return plots


def cycle_plots(cycles: list[CycleAngles], gait: Gait) -> list[Plot]:
    """One plot per angle over 0 to 100 % of the gait cycle: mean, standard deviation and single strides, left and right."""
    groups: dict[str, list[CycleAngles]] = {}
    for one in sorted(cycles, key=lambda one: rank_of(one.joint)):
        groups.setdefault(title_of(one.joint, one.angle), []).append(one)
    return [
        Plot(title, [*_foot_off(gait), *(part for one in members for part in _cycle_series(one))], x_label="% of the gait cycle",
             y_label="degrees", window=_window(members), legend=False)
        for title, members in groups.items()
    ]  # fmt: skip


def range_table(joints: JointAngles, person: int) -> Table:
    """Least, most, range and mean of every angle over the whole recording."""
    rows = []
    for title, members in _grouped(joints).items():
        for q, a in members:
            values = np.degrees(joints.angle_rad[:, person, q, a])
            known = values[np.isfinite(values)]
            if len(known) <= _SHARE_DRAWN * len(values):
                continue
            sigma = float(np.degrees(np.nanmedian(joints.sigma_rad[:, person, q, a])))
            side = side_of(joints.joints[q])
            figures = [f"{figure:.1f}" for figure in (known.min(), known.max(), np.ptp(known), known.mean(), sigma)]
            shown = "" if side == "mid" else Cell(side, side)
            rows.append([title, shown, *figures, f"{100 * len(known) / len(values):.0f} %"])
    columns = ["angle, degrees", "side", "least", "greatest", "range", "mean", "standard deviation", "known in"]
    return Table(columns, rows)


def _cycle_series(one: CycleAngles) -> list[Series]:
    side = side_of(one.joint)
    mean, sd = np.degrees(one.mean_rad), np.degrees(one.sd_rad)
    single = [
        Line(f"{side} stride {i}", PERCENT, np.degrees(values), colour=side, faint=True)
        for i, values in enumerate(one.angle_rad[:_MOST_CYCLES], start=1)
    ]
    name = f"{side if side in _SIDES else 'trunk'}, mean of {len(one.angle_rad)}"
    return [*single, Band(f"{side} ± sd", PERCENT, mean - sd, mean + sd, colour=side), Line(name, PERCENT, mean, colour=side)]


def _foot_off(gait: Gait) -> list[Series]:
    shares = {side: gait.stance_share[side].mean for side in _SIDES}
    return [
        Ticks(f"{side} foot off", np.array([100 * share]), colour=side) for side, share in shares.items() if np.isfinite(share)
    ]


def _window(members: list[CycleAngles]) -> tuple[float, float, float, float]:
    """All of the means and bands, with room."""
    low = min(float(np.degrees(one.mean_rad - one.sd_rad).min()) for one in members)
    high = max(float(np.degrees(one.mean_rad + one.sd_rad).max()) for one in members)
    room = 0.15 * (high - low) + 1.0
    return 0.0, 100.0, low - room, high + room


def _grouped(joints: JointAngles) -> dict[str, list[tuple[int, int]]]:
    """Places (joint, angle) by title, left and right of one angle together, legs first.

    The heading of the pelvis is left out: it counts the person's turns in the room, and is no angle of a joint.
    """
    groups: dict[str, list[tuple[int, int]]] = {}
    for q, joint in sorted(enumerate(joints.joints), key=lambda one: rank_of(one[1])):
        for a, angle in enumerate(joints.angle_names[q]):
            if (joint, angle) == HEADING:
                continue
            groups.setdefault(title_of(joint, angle), []).append((q, a))
    return groups
