"""What a user may set about fusion; each default exists once, here."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from posefuse.foundation.settings import settings

Weights = Literal["none", "score", "all", "robust"]
WEIGHTS: tuple[Weights, ...] = ("none", "score", "all", "robust")


@settings
class FuseSettings:
    """How the views of one time step are fused into one 3D pose.

    Attributes:
        weights: how the views are weighted: ``robust`` (1/sigma^2, with consensus and a robust loss), or the weights of the
            paper: ``none``, ``score``, ``all``.
        score_threshold: ``score`` and ``all``: views with a lower score have weight 0 (s_th of the paper).
        distance_min_m, distance_max_m: ``all``: range of camera distances with full weight (d_min and d_max of the paper).
        distance_fall_m: ``all``: length over which the weight falls to 0 outside that range.
        score_min: ``robust``: views with a lower score are not used.
        sigma_share, sigma_min_px: standard deviation of a keypoint of score 1 for detectors that state none: a share of the
            larger side of the extent of the body in that view, and at least this many px. It grows as 1 / score, so that 1 /
            sigma^2 is the score^2 of the paper. The default lies within the spread of human annotators (COCO keypoint
            similarity: 0.007 to 0.03 of the height).
    """

    weights: Weights = "robust"
    score_threshold: Annotated[float, Ge(0), Le(1)] = 0.4
    distance_min_m: Annotated[float, Ge(0)] = 1.0
    distance_max_m: Annotated[float, Gt(0)] = 8.0
    distance_fall_m: Annotated[float, Gt(0)] = 4.0
    score_min: Annotated[float, Ge(0), Le(1)] = 0.1
    sigma_share: Annotated[float, Ge(0)] = 0.015
    sigma_min_px: Annotated[float, Gt(0)] = 1.0
