"""What a user may set about fusion; each default exists once, here."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from posefuse.foundation.settings import settings

Weights = Literal["none", "score", "all", "robust"]
WEIGHTS: tuple[Weights, ...] = ("none", "score", "all", "robust")


@settings
class FuseSettings:
    """How the views of one instant become one 3D pose.

    Attributes:
        weights: ``robust`` (1/sigma^2, consensus, outliers cannot pull), or the paper's ``none``, ``score``, ``all``.
        score_threshold: ``score`` and ``all``: views below it weigh nothing (the paper's s_th).
        distance_min_m, distance_max_m: ``all``: camera distances of full weight (the paper's d_min, d_max).
        distance_fall_m: ``all``: over which length the weight falls to 0 on either side of that range.
        score_min: ``robust``: views below it are not used at all.
        sigma_share, sigma_min_px: noise of a keypoint of score 1 where the detector states none, as a share of the larger
            side of the body's extent in that view, and at least so many px. It grows as 1 / score, so that 1 / sigma^2 is
            the paper's score^2. The default is what people who annotate joints differ by (COCO's keypoint similarity:
            0.007 to 0.03 of the height).
        untangle_sides: exchange left and right in a view that fits better that way (``robust`` only).
    """

    weights: Weights = "robust"
    score_threshold: Annotated[float, Ge(0), Le(1)] = 0.4
    distance_min_m: Annotated[float, Ge(0)] = 1.0
    distance_max_m: Annotated[float, Gt(0)] = 8.0
    distance_fall_m: Annotated[float, Gt(0)] = 4.0
    score_min: Annotated[float, Ge(0), Le(1)] = 0.1
    sigma_share: Annotated[float, Ge(0)] = 0.015
    sigma_min_px: Annotated[float, Gt(0)] = 1.0
    untangle_sides: bool = True
