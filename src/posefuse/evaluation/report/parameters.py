"""The table of gait parameters, with what is normal and where that is published."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from posefuse.evaluation.gait_cycles import CycleAngles
from posefuse.formats.page import MISSING, Block, Cell, Details, Facts, Note, Table
from posefuse.kinematics.gait import Gait, Spread

from .angles import title_of
from .normal import CADENCE, CAUTION, NONE, SOURCES, SPEED, STANCE, STRIDE_LENGTH, Normal

# a space at which a line does not break
_KEPT = "\N{NO-BREAK SPACE}"
_SIDES: tuple[Literal["left", "right"], ...] = ("left", "right")
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
