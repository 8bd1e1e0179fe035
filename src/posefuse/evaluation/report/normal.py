"""What is normal: published values of healthy adults, each with its source."""

from __future__ import annotations

from dataclasses import dataclass

SOURCES = {
    "Bohannon 1997": (
        "R. W. Bohannon, Comfortable and maximum walking speed of adults aged 20-79 years: reference values and determinants, "
        "Age and Ageing 26 (1997) 15-19; comfortable speed, means of men and women of each decade of age"
    ),
    "Perry & Burnfield 2010": "J. Perry, J. M. Burnfield, Gait Analysis: Normal and Pathological Function, 2nd ed., SLACK, 2010",
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
CADENCE = Normal("113 steps/min", "Perry & Burnfield 2010")
STRIDE_LENGTH = Normal("1.41 m", "Perry & Burnfield 2010")
STANCE = Normal("62 %", "Perry & Burnfield 2010")
# range over the gait cycle
RANGES = {
    ("hip", "flexion"): Normal("about 40°", "Perry & Burnfield 2010"),
    ("knee", "flexion"): Normal("about 60°", "Perry & Burnfield 2010"),
    ("ankle", "dorsiflexion"): Normal("about 30° (20° to 40°)", "Perry & Burnfield 2010"),
}
