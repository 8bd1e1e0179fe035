"""The shape and the colours of one simulated person, as a scene file states them."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Le
from pydantic import Field

from posefuse.foundation.settings import settings

Colour = Annotated[str, Field(pattern=r"^#[0-9a-fA-F]{6}$")]
Unit = Annotated[float, Ge(0), Le(1)]


@settings
class BodyShapeSettings:
    """One body. A key that is left out is drawn from `random_seed` if that is given, else it is the default below.

    Attributes:
        random_seed: any whole number >= 0: draw everything that is not given.
        sex: ``female``, ``male``, or anything between from 0 (female) to 1 (male); default male.
        age_years: 5 to 90 years; default 30.
        height_m: stature in metres; default: an average adult's (1.63 female, 1.77 male).
        weight_kg: body mass; default: mid-range of what the body model offers at this stature; it offers a body mass index of
            about 17 to 25 for adults, and the error of anything else names the range.
        muscle: 0 (slack) to 1 (athletic); default 0.5.
        shirt, trousers, shoes, skin, hair: ``#rrggbb``.
    """

    random_seed: Annotated[int, Ge(0)] | None = None
    sex: Literal["female", "male"] | Unit | None = None
    age_years: Annotated[float, Ge(5), Le(90)] | None = None
    height_m: Annotated[float, Ge(0.9), Le(2.3)] | None = None
    weight_kg: Annotated[float, Ge(10), Le(200)] | None = None
    muscle: Unit | None = None
    shirt: Colour | None = None
    trousers: Colour | None = None
    shoes: Colour | None = None
    skin: Colour | None = None
    hair: Colour | None = None
