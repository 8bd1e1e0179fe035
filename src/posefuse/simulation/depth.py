"""The depth that a simulated camera measures as well as colour."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt, Le

from posefuse.foundation.settings import settings


@settings
class DepthSettings:
    """A stereo depth camera aligned with the colour image; see `render.depth` for the model. The defaults resemble a RealSense
    D435 at 848 x 480.

    Attributes:
        focal_px: of the depth imager. baseline_m: between its two lenses.
        disparity_sigma_px: error of a match. step_px: smallest step of the disparity; 0 for none.
        floor_m: error that does not grow with distance.
        block_px: width of the matched blocks, over which errors are alike.
        lateral_px: how far off its place a pixel looks, one standard deviation.
        edge_loss: share of the pixels next to edges of depth that have no depth.
        reach_m: nothing is measured farther away.
    """

    focal_px: Annotated[float, Gt(0)] = 425.0
    baseline_m: Annotated[float, Gt(0), Le(10)] = 0.05
    disparity_sigma_px: Annotated[float, Ge(0)] = 0.08
    step_px: Annotated[float, Ge(0), Le(1)] = 1 / 32
    floor_m: Annotated[float, Ge(0)] = 0.003
    block_px: Annotated[float, Ge(1), Le(100)] = 5.0
    lateral_px: Annotated[float, Ge(0), Le(20)] = 0.8
    edge_loss: Annotated[float, Ge(0), Le(1)] = 0.5
    reach_m: Annotated[float, Gt(0), Le(65)] = 10.0
