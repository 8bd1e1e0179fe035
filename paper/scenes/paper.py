"""The paper's own numbers, in one place.

Source: "Markerless 3D human pose tracking through multiple cameras and AI", table "Static assessment of the weights effect in
the 3D reconstruction" and the text of the walking and latency experiments (Gazebo simulation, OpenPose on GPUs). Millimetres.
"""

from __future__ import annotations

from collections.abc import Mapping

from posefuse.core import PAPER14

# the paper's table "Static assessment of the weights effect" and its text; per joint
# in the order of `PAPER14`: mean and standard deviation for no weights, score weight, all weights
_FREE = (
    (13.44, 0.4, 12.96, 0.37, 14.57, 0.43),
    (3.77, 0.60, 3.70, 0.64, 4.51, 0.71),
    (13.28, 28.68, 10.86, 0.71, 12.29, 0.97),
    (145.72, 282.33, 14.47, 0.62, 13.27, 0.76),
    (11.95, 0.50, 10.28, 0.40, 11.80, 0.52),
    (359.07, 0.68, 7.19, 1.16, 6.96, 1.41),
    (376.84, 7.82, 14.66, 0.76, 13.69, 0.85),
    (9.29, 0.33, 10.01, 0.27, 9.12, 0.40),
    (12.14, 0.58, 14.33, 0.60, 13.44, 0.56),
    (7.51, 0.54, 8.09, 0.47, 8.03, 0.52),
    (13.01, 0.41, 12.98, 0.31, 11.85, 0.39),
    (11.23, 0.96, 12.88, 0.81, 11.98, 1.06),
    (7.39, 0.69, 6.55, 0.51, 7.25, 0.60),
    (8.91, 0.66, 9.15, 0.63, 7.92, 0.70),
)
_OCCLUDED = (
    (10.85, 0.38, 10.82, 0.49, 10.77, 0.65),
    (9.20, 0.68, 22.15, 0.86, 12.23, 0.78),
    (715.68, 505.49, 75.72, 6.24, 29.95, 5.68),
    (1066.02, 322.85, 117.68, 18.03, 59.80, 7.87),
    (145.51, 58.40, 20.53, 1.19, 12.28, 1.58),
    (220.33, 23.73, 51.87, 3.64, 39.43, 3.38),
    (340.58, 76.22, 5.98, 11.80, 6.08, 2.44),
    (410.09, 1.94, 8.20, 0.69, 5.79, 1.76),
    (491.48, 13.41, 9.01, 2.28, 9.42, 1.90),
    (548.00, 20.48, 11.47, 0.68, 12.92, 0.96),
    (602.63, 30.25, 8.96, 1.79, 5.75, 1.29),
    (498.04, 30.20, 7.68, 1.20, 16.99, 2.22),
    (548.94, 40.28, 9.25, 0.78, 8.83, 1.19),
    (600.34, 52.75, 10.95, 0.82, 9.04, 0.36),
)
_COLUMNS = ("none", "score", "all")

Column = Mapping[str, tuple[float, float]]

# case -> weights -> joint -> (mean, standard deviation)
STATIC: Mapping[str, Mapping[str, Column]] = {
    case: {
        weights: {joint: (row[2 * i], row[2 * i + 1]) for joint, row in zip(PAPER14.keypoints, table, strict=True)}
        for i, weights in enumerate(_COLUMNS)
    }
    for case, table in (("free", _FREE), ("occluded", _OCCLUDED))
}
# the averages the paper prints under its columns
STATIC_AVERAGE: Mapping[str, Mapping[str, float]] = {
    "free": {"none": 70.97, "score": 10.58, "all": 10.48},
    "occluded": {"none": 443.40, "score": 26.44, "all": 17.09},
}
WALKING_MEAN, WALKING_WORST, WALKING_BEST = 25.83, 33.07, 15.75
DETECT_MS, TRIANGULATE_MS = (25.0, 125.0), 1.0
