"""Angles of the report: over time, over the gait cycle, their ranges; gait parameters, and what is normal, with sources."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from posefuse.core import JointAngles
from posefuse.formats.page import MISSING, Band, Block, Cell, Details, Facts, Line, Note, Plot, Series, Table, Ticks
from posefuse.kinematics.gait import Gait, Spread

from .gait_cycles import HEADING, PERCENT, CycleAngles, side_of

SOURCES = {
    "Bohannon 1997": (
        "R. W. Bohannon, Comfortable and maximum walking speed of adults aged 20-79 years: reference values and determinants, "
        "Age and Ageing 26 (1997) 15-19; comfortable speed, means of men and women of each decade of age"
    ),
    "Thompson 2002 (secondary)": (
        "Secondary source: D. Thompson, Stride analysis, University of Oklahoma Health Sciences Center (2002), with means "
        "adapted from M. P. Murray, A. B. Drought, R. C. Kory, J. Bone Joint Surg. 46A (1964) 335-360 (men), and M. P. Murray, "
        "R. C. Kory, S. B. Sepic, Arch. Phys. Med. Rehabil. 51 (1970) 637-650 (women); the originals were not checked"
    ),
    "Physiopedia (secondary)": (
        "Secondary source: Physiopedia, Joint range of motion during gait, which refers to J. Loudon et al., The Clinical "
        "Orthopedic Assessment Guide, 2nd ed., Human Kinetics, 2008, 395-408; the original was not checked"
    ),
}
CAUTION = (
    "Normal values are of healthy adults who walk at a speed they choose. They change with age, sex, height and speed, and other "
    "systems define angles differently: use them for orientation, not for a diagnosis. Where no normal value is given, none is "
    "cited here."
)


@dataclass(frozen=True)
class Normal:
    """A published value, as text with its unit, and the key of `SOURCES` it is from."""

    text: str = ""
    source: str = ""


NONE = Normal()
SPEED = Normal("1.27 to 1.46 m/s, by age and sex", "Bohannon 1997")
CADENCE = Normal("117 steps/min", "Thompson 2002 (secondary)")
STRIDE_LENGTH = Normal("1.58 m (men), 1.32 m (women)", "Thompson 2002 (secondary)")
STANCE = Normal("60 %", "Physiopedia (secondary)")


_SHARE_DRAWN = 0.02
# single strides drawn per side; all of them are in gait_cycles.csv
_MOST_CYCLES = 10
_SIDES: tuple[Literal["left", "right"], ...] = ("left", "right")
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


# a space at which a line does not break
_KEPT = "\N{NO-BREAK SPACE}"
# angles whose range over the gait cycle is in the table; definitions differ too much between systems to cite a normal value
RANGES = (("hip", "flexion"), ("knee", "flexion"), ("ankle", "dorsiflexion"))
_ASYMMETRY = "Asymmetry of the {}"
_COLUMNS = ("parameter", "side", "value", "normal for adults", "source")


def parameter_blocks(gait: Gait | None, cycles: list[CycleAngles]) -> list[Block]:
    """The table with its notes; a note only where the person does not walk."""
    if gait is None:
        return [Note("No walking found: gait parameters need two foot strikes of each foot.")]
    rows = [
        _row("Walking speed", f"{gait.speed_m_s:.2f}{_KEPT}m/s", SPEED),
        _row("Cadence", f"{gait.cadence_per_min:.0f}{_KEPT}steps/min", CADENCE),
        _row("Stride length", spread_text(gait.stride_length_m, "m"), STRIDE_LENGTH),
        _row("Stride time", spread_text(gait.stride_time_s, "s")),
        *(_row("Step length", spread_text(gait.step_length_m[side], "m"), side=side) for side in _SIDES),
        _row("Step width", spread_text(gait.step_width_m, "m")),
        _row(_ASYMMETRY.format("step length"), _asymmetry(gait.step_length_m)),
        *(_row("Stance phase", spread_text(gait.stance_share[side], "%", 100.0, 0), STANCE, side) for side in _SIDES),
        _row(_ASYMMETRY.format("stance phase"), _asymmetry(gait.stance_share)),
        _row("Double support", spread_text(gait.double_support_share, "%", 100.0, 0)),
        *_ranges(cycles),
    ]
    used = {row[-1] for row in rows} & set(SOURCES)
    return [
        Table(_COLUMNS, rows, text=True),
        Note("Mean ± standard deviation (number of steps or strides). Asymmetry: left minus right, as a share of their mean."),
        Note(CAUTION),
        Details("Sources of the normal values", [Facts({key: text for key, text in SOURCES.items() if key in used})]),
    ]


def spread_text(spread: Spread, unit: str, scale: float = 1.0, digits: int = 2) -> str:
    """``0.71 ± 0.02 m (12)``, broken before the count alone; a dash for none."""
    if not spread.count:
        return MISSING
    unit = unit if unit == "°" else f"{_KEPT}{unit}"
    return f"{scale * spread.mean:.{digits}f}{_KEPT}±{_KEPT}{scale * spread.sd:.{digits}f}{unit} ({spread.count})"


def _asymmetry(sides: Mapping[str, Spread]) -> str:
    """Left minus right, in per cent of their mean; a dash where one is not known."""
    left, right = (sides[side].mean for side in _SIDES)
    share = 100 * (left - right) / ((left + right) / 2)
    return f"{share:+.0f}{_KEPT}%" if np.isfinite(share) else MISSING


def _ranges(cycles: list[CycleAngles]) -> list[list[Any]]:
    """Range over the gait cycle of `RANGES`."""
    return [
        _row(
            f"{title_of(part, angle)}, range over the gait cycle",
            spread_text(Spread.of(np.degrees(one.ranges_rad)), "°", digits=0),
            side=one.side,
        )
        for part, angle in RANGES
        for one in cycles
        if (one.joint, one.angle) == (f"{one.side}_{part}", angle)
    ]


def _row(name: str, value: str, normal: Normal = NONE, side: Literal["", "left", "right"] = "") -> list[Any]:
    return [name, Cell(side, side), value, normal.text, normal.source]
