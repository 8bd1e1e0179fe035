"""How one simulated person moves, as a scene file states it. Headings are counter-clockwise from world +X."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le
from pydantic import Field

from posefuse.core import ConfigError
from posefuse.core.errors import choices
from posefuse.foundation.settings import settings

Place = tuple[float, float]
Seconds = Annotated[float, Gt(0), Le(60)]
Side = Literal["left", "right"]


@settings
class StandSettings:
    """Stands on one spot.

    Attributes:
        kind: ``tpose``: the arms exactly horizontal. ``idle``: at ease: sways, breathes, looks about. ``reach``: reaches for one
            point after another, drawn by the seed, in front of the shoulder. ``squat``: again and again. ``wave``: with one
            hand. ``overhead``: raises both arms above the head and lowers them. ``sit``: sits down on something as high as the
            knee, which is not drawn, and gets up. ``turn``: to the left on the spot, step by step.
        position_m: x, y on the floor between the feet (turn: at time 0). heading_deg: where the person faces.
        side: the arm of reach and wave.
        period_s: from one reach, squat, wave, raising of the arms or standing to the next, or of a whole turn; None: 3 s (reach,
            overhead), 4 s (squat), 0.9 s (wave), 6 s (sit, turn).
        sway: of idle, reach and wave: 1 is a healthy adult's, 0 stands like a statue.
        knee_flexion_deg: deepest of a squat, 20 to 120.
    """

    kind: Literal["tpose", "idle", "reach", "squat", "wave", "overhead", "sit", "turn"]
    position_m: Place = (0.0, 0.0)
    heading_deg: float = 0.0
    side: Side = "right"
    period_s: Seconds | None = None
    sway: Annotated[float, Ge(0), Le(3)] = 1.0
    knee_flexion_deg: Annotated[float, Ge(20), Le(120)] = 95.0


@settings
class CirclePath:
    """Round a circle, counter-clockwise unless `clockwise`.

    Attributes:
        radius_m: of the pelvis's path, at least 0.5 m. centre_m: x, y. start_deg: where on the circle at time 0.
    """

    shape: Literal["circle"]
    radius_m: Annotated[float, Ge(0.5), Le(100)] = 1.5
    centre_m: Place = (0.0, 0.0)
    start_deg: float = 0.0
    clockwise: bool = False


@settings
class LinePath:
    """From a start to an end, where the person stops and stays.

    Attributes:
        start_m, end_m: x, y, at least 1 m apart.
    """

    shape: Literal["line"]
    start_m: Place
    end_m: Place


@settings
class BackForthPath:
    """There and back again, for ever.

    Attributes:
        start_m, end_m: x, y, at least 1 m apart.
        facing: ``travel`` turns round at the ends, in a half circle of 0.4 m to the left, so that the way back lies
            two radii to the side of the path there; ``sideways`` keeps facing one way (the left of the way from start to end is
            ahead) and side-steps along the same line.
    """

    shape: Literal["back_forth"]
    start_m: Place
    end_m: Place
    facing: Literal["travel", "sideways"] = "travel"


@settings
class RandomPath:
    """A smooth closed way through an area, drawn by the seed.

    Attributes:
        low_m, high_m: corners of the area, x, y; at least 2 m each way.
    """

    shape: Literal["random"]
    low_m: Place = (-1.5, -1.5)
    high_m: Place = (1.5, 1.5)


WalkPath = Annotated[CirclePath | LinePath | BackForthPath | RandomPath, Field(discriminator="shape")]


@settings
class WalkSettings:
    """Walks along a path.

    Attributes:
        path: where. speed_mps: of the pelvis along the path, except where it slows down in narrow turns and at ends.
    """

    kind: Literal["walk"]
    path: WalkPath
    speed_mps: Annotated[float, Ge(0.2), Le(2.2)] = 1.35


@settings
class RecordedSettings:
    """Motion from a file: the markers or keypoints of a TRC file, or a recorded posefuse result (Real2Sim).

    Attributes:
        kind: ``trc``: by markers named as our keypoints, in the spellings that `compare` reads (``RKnee``). ``result``: a folder.
        file: the file or folder. person: which id of a result; None: the one seen longest.
        position_m: where the pelvis is at the start; None keeps the place of the file or result. The last pose stays.
    """

    kind: Literal["trc", "result"]
    file: str
    person: int | None = None
    position_m: Place | None = None


MotionSettings = Annotated[StandSettings | WalkSettings | RecordedSettings, Field(discriminator="kind")]
# what each kind has of the settings that not all kinds of its class have
_OWN = {
    "idle": ("sway",),
    "reach": ("side", "period_s", "sway"),
    "squat": ("period_s", "knee_flexion_deg"),
    "wave": ("side", "period_s", "sway"),
    "overhead": ("period_s",),
    "sit": ("period_s",),
    "turn": ("period_s",),
    "result": ("person",),
}
_SHARED = ("kind", "file", "position_m")


def check_motion(motion: StandSettings | WalkSettings | RecordedSettings, where: str) -> None:
    """Raise ConfigError for a setting of another kind of motion; `where` begins the message."""
    if isinstance(motion, WalkSettings):
        return
    usual = {field.name: field.default for field in fields(motion)}
    own = {*_SHARED, *_OWN.get(motion.kind, ()), *(("heading_deg",) if isinstance(motion, StandSettings) else ())}
    for name, value in vars(motion).items():
        if name not in own and value != usual[name]:
            raise ConfigError(f"{where}.{name}: {motion.kind} has none; there are: {choices(sorted(own & usual.keys()))}")
