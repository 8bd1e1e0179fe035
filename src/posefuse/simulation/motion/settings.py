"""How one simulated person moves, as a scene file states it. Headings are counter-clockwise from world +X."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, MinLen
from pydantic import Field

from posefuse.foundation.settings import settings

Place = tuple[float, float]
Seconds = Annotated[float, Gt(0), Le(60)]
Side = Literal["left", "right"]


@settings
class TPoseSettings:
    """Stands still with the arms exactly horizontal.

    Attributes:
        position_m: x, y on the floor. heading_deg: where the person faces.
    """

    kind: Literal["tpose"]
    position_m: Place = (0.0, 0.0)
    heading_deg: float = 0.0


@settings
class IdleSettings:
    """Stands at ease: sways, breathes, looks about.

    Attributes:
        position_m, heading_deg: as for tpose. sway: 1 is a healthy adult's, 0 stands like a statue.
    """

    kind: Literal["idle"]
    position_m: Place = (0.0, 0.0)
    heading_deg: float = 0.0
    sway: Annotated[float, Ge(0), Le(3)] = 1.0


@settings
class ReachSettings:
    """Stands and reaches for one point after another, drawn by the seed, in front of the shoulder.

    Attributes:
        position_m, heading_deg: as for tpose. side: the arm. period_s: from one reach to the next.
    """

    kind: Literal["reach"]
    position_m: Place = (0.0, 0.0)
    heading_deg: float = 0.0
    side: Side = "right"
    period_s: Seconds = 3.0


@settings
class HandPathSettings:
    """Stands and moves one wrist along a path, as the operator of a robot does.

    Attributes:
        position_m, heading_deg: as for tpose. side: the arm. sway: as for idle.
        path: rows of time in s and the wrist's place from the floor point between the feet, m: ahead, left, up. Between two rows
            the hand moves straight with minimum jerk; before the first and after the last it rests.
    """

    kind: Literal["hand_path"]
    path: Annotated[tuple[tuple[float, float, float, float], ...], MinLen(1)]
    position_m: Place = (0.0, 0.0)
    heading_deg: float = 0.0
    side: Side = "right"
    sway: Annotated[float, Ge(0), Le(3)] = 1.0


@settings
class SquatSettings:
    """Squats again and again.

    Attributes:
        position_m, heading_deg: as for tpose. period_s: of one squat. knee_flexion_deg: deepest, 20 to 120.
    """

    kind: Literal["squat"]
    position_m: Place = (0.0, 0.0)
    heading_deg: float = 0.0
    period_s: Seconds = 4.0
    knee_flexion_deg: Annotated[float, Ge(20), Le(120)] = 95.0


@settings
class WaveSettings:
    """Stands and waves with one hand.

    Attributes:
        position_m, heading_deg: as for tpose. side: the arm. period_s: of one wave.
    """

    kind: Literal["wave"]
    position_m: Place = (0.0, 0.0)
    heading_deg: float = 0.0
    side: Side = "right"
    period_s: Seconds = 0.9


@settings
class OverheadSettings:
    """Raises both arms above the head and lowers them.

    Attributes:
        position_m, heading_deg: as for tpose. period_s: up and down.
    """

    kind: Literal["overhead"]
    position_m: Place = (0.0, 0.0)
    heading_deg: float = 0.0
    period_s: Seconds = 3.0


@settings
class SitSettings:
    """Sits down on something as high as the knee, which is not drawn, and gets up.

    Attributes:
        position_m: of the feet. heading_deg: as for tpose. period_s: from standing to standing.
    """

    kind: Literal["sit"]
    position_m: Place = (0.0, 0.0)
    heading_deg: float = 0.0
    period_s: Seconds = 6.0


@settings
class TurnSettings:
    """Turns to the left on the spot, step by step.

    Attributes:
        position_m, heading_deg: as for tpose, at time 0. period_s: of a whole turn.
    """

    kind: Literal["turn"]
    position_m: Place = (0.0, 0.0)
    heading_deg: float = 0.0
    period_s: Seconds = 6.0


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
        facing: ``travel`` turns round at the ends, in a half circle of `turn_radius_m` to the left, so that the way back lies
            two radii to the side of the path there; ``sideways`` keeps facing one way (the left of the way from start to end is
            ahead) and side-steps along the same line.
        turn_radius_m: at least 0.25 m; the person slows down in the turn.
    """

    shape: Literal["back_forth"]
    start_m: Place
    end_m: Place
    facing: Literal["travel", "sideways"] = "travel"
    turn_radius_m: Annotated[float, Ge(0.25), Le(5)] = 0.4


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
class BvhSettings:
    """Motion from a BVH file.

    Attributes:
        file: the .bvh; joints by CMU, Mixamo or common names.
        position_m, heading_deg: where the pelvis is at the file's start, and where it faces; None keeps the file's own
            heading (+Z of the file, Y up, is world +X).
        start_s: the file's time shown at time 0. loop: start again at the end; otherwise the last pose stays.
    """

    kind: Literal["bvh"]
    file: str
    position_m: Place = (0.0, 0.0)
    heading_deg: float | None = None
    start_s: Annotated[float, Ge(0)] = 0.0
    loop: bool = False


@settings
class TrcSettings:
    """Motion from marker or keypoint trajectories of a TRC file; see `points` for which markers are used.

    Attributes:
        file: the .trc. up: the file's vertical axis. position_m: None keeps the file's own place, else as for bvh.
        start_s, loop: as for bvh.
    """

    kind: Literal["trc"]
    file: str
    up: Literal["y", "z"] = "y"
    position_m: Place | None = None
    start_s: Annotated[float, Ge(0)] = 0.0
    loop: bool = False


@settings
class ResultSettings:
    """Motion from a recorded posefuse result (Real2Sim).

    Attributes:
        file: the result file. person: which id in it; None takes the one seen longest.
        position_m: None keeps the recorded place, else as for bvh. start_s, loop: as for bvh.
    """

    kind: Literal["result"]
    file: str
    person: int | None = None
    position_m: Place | None = None
    start_s: Annotated[float, Ge(0)] = 0.0
    loop: bool = False


StandingSettings = (
    TPoseSettings
    | IdleSettings
    | ReachSettings
    | HandPathSettings
    | SquatSettings
    | WaveSettings
    | OverheadSettings
    | SitSettings
    | TurnSettings
)
MotionSettings = Annotated[
    StandingSettings | WalkSettings | BvhSettings | TrcSettings | ResultSettings, Field(discriminator="kind")
]
