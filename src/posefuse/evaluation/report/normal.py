"""What is normal: published values of healthy adults, each with its source."""

from __future__ import annotations

from dataclasses import dataclass

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
