"""The table of gait parameters, with what is normal and where that is published."""

from __future__ import annotations

import numpy as np

from posefuse.evaluate.gait_cycles import CycleAngles, side_of
from posefuse.files.page import MISSING, Block, Details, Facts, Note, Table
from posefuse.kinematics.gait import Gait, Spread

from .angles import title_of
from .normal import CADENCE, CAUTION, NONE, RANGES, SOURCES, SPEED, STANCE, STRIDE_LENGTH, Normal

# a space at which a line does not break
_KEPT = "\N{NO-BREAK SPACE}"
_COLUMNS = ("parameter", "left", "right", "both", "normal for adults", "source")


def parameter_blocks(gait: Gait | None, cycles: list[CycleAngles]) -> list[Block]:
    """The table with its notes; a note alone where nobody walks."""
    if gait is None:
        return [Note("No walking found: gait parameters need two foot strikes of each foot.")]
    rows = [
        _row("Walking speed", SPEED, both=f"{gait.speed_m_s:.2f} m/s"),
        _row("Cadence", CADENCE, both=f"{gait.cadence_per_min:.0f} steps/min"),
        _row("Stride length", STRIDE_LENGTH, both=spread_text(gait.stride_length_m, "m")),
        _row("Stride time", NONE, both=spread_text(gait.stride_time_s, "s")),
        _row("Step length", NONE, **{side: spread_text(one, "m") for side, one in gait.step_length_m.items()}),
        _row("Step width", NONE, both=spread_text(gait.step_width_m, "m")),
        _row("Stance phase", STANCE, **{side: spread_text(one, "%", 100.0, 0) for side, one in gait.stance_share.items()}),
        *_ranges(cycles),
    ]
    used = {row[-1] for row in rows} & set(SOURCES)
    return [
        Table(_COLUMNS, rows, text=True),
        Note("Mean ± standard deviation (number of steps or strides)."),
        Note(CAUTION),
        Details("Sources of the normal values", [Facts({key: text for key, text in SOURCES.items() if key in used})]),
    ]


def spread_text(spread: Spread, unit: str, scale: float = 1.0, digits: int = 2) -> str:
    """``0.71 ± 0.02 m (12)``, broken before the count alone; a dash for none."""
    if not spread.count:
        return MISSING
    unit = unit if unit == "°" else f"{_KEPT}{unit}"
    return f"{scale * spread.mean:.{digits}f}{_KEPT}±{_KEPT}{scale * spread.sd:.{digits}f}{unit} ({spread.count})"


def _ranges(cycles: list[CycleAngles]) -> list[list[str]]:
    """Range of every angle of a limb over the gait cycle, where a normal value is cited."""
    rows = []
    for (part, angle), normal in RANGES.items():
        texts = {
            side_of(one.joint): spread_text(_spread(np.degrees(one.ranges_rad)), "°", digits=0)
            for one in cycles
            if one.joint in (f"left_{part}", f"right_{part}") and one.angle == angle
        }
        if texts:
            rows.append(_row(f"{title_of(part, angle)}, range over the gait cycle", normal, **texts))
    return rows


def _spread(values: np.ndarray) -> Spread:
    return Spread(float(values.mean()), float(values.std()), len(values))


def _row(name: str, normal: Normal, *, left: str = "", right: str = "", both: str = "") -> list[str]:
    return [name, left, right, both, normal.text, normal.source]
