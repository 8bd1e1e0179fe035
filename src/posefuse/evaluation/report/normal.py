"""What is normal: published values of healthy adults, each with its source."""

from __future__ import annotations

from dataclasses import dataclass

SOURCES = {
    "Bohannon 1997": (
        "R. W. Bohannon, Comfortable and maximum walking speed of adults aged 20-79 years: reference values and determinants, "
        "Age and Ageing 26 (1997) 15-19; comfortable speed, means of men and women of each decade of age"
    ),
    "Murray 1964, 1970": (
        "M. P. Murray, A. B. Drought, R. C. Kory, Walking patterns of normal men, J. Bone Joint Surg. 46A (1964) 335-360; "
        "M. P. Murray, R. C. Kory, S. B. Sepic, Walking patterns of normal women, Arch. Phys. Med. Rehabil. 51 (1970) 637-650; "
        "as quoted by D. Thompson, Stride analysis, University of Oklahoma Health Sciences Center (2002)"
    ),
    "Loudon 2008": (
        "J. Loudon et al., The Clinical Orthopedic Assessment Guide, 2nd ed., Human Kinetics, 2008, 395-408; as quoted by "
        "Physiopedia, Joint range of motion during gait"
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
CADENCE = Normal("117 steps/min", "Murray 1964, 1970")
STRIDE_LENGTH = Normal("1.58 m (men), 1.32 m (women)", "Murray 1964, 1970")
STANCE = Normal("60 %", "Loudon 2008")
