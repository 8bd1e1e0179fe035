"""What refuses a calibration: every threshold with its unit and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Limits:
    """Thresholds of the checks of a rig from a prop or board.

    "bench" is `bench/calibration_faults.py`. Judgement: set by the author. No fault there fails
    `corner_spread` or `apart_m` alone, and none fails `own_*`, which have tests only.

    Attributes:
        corner_spread_px_per_1000: of a corner coordinate, per 1000 px of image width. Detection leaves 0.1 to 0.4 (docs).
        segments, segment_views, segment_share: the recording is cut into so many parts; a part of a camera with so many views
            must agree by this share. Judgement.
        position_sigma_share: standard error of a camera's position over the target's usual distance. Judgement: 20 mm of 4 m.
        spread_ratio: of residuals in one rig to those in a rig for each half. Good sessions: 1.1 (bench), four webcams of
            `caliscope` 1.24, whose lens model is not quite theirs.
        moved_sigma: a spread ratio above its limit refuses with a pose that differs between the halves by so many standard
            errors. Judgement.
        turned_rad: a camera may turn by this against the others over the recording, as in the background of its images
            (`health.background`). Three of the webcams, which stand still, show 0.15 deg of 9 standard errors.
        focal_share: focal lengths that are let free may change by this. Intrinsics from a board repeat to 0.1 to 0.3 % (docs).
        centre_rad: and the principal point by this. Judgement; the webcams, whose rig is right, show 2.2 deg, which their halves
            do not confirm.
        bend_px_per_1000: and image points at the rim by distortion, per 1000 px of width. Judgement.
        stretch_share: a board may be longer in one direction by this: printers are true to 0.5 %.
        lens_sigma: none of the five refuses below so many standard errors.
        own_depth_ratio, own_focal_sigma, own_bend_px_per_1000: intrinsics from the recording of the extrinsics need a target that
            was so much farther away at times, and standard errors of focal length (share) and distortion at the rim below these.
            Judgement: what a board gives (0.1 to 0.3 %), and the limits above.
        late_s, drift, late_sigma: clocks of synchronised cameras. 4 ms is 4 mm at 1 m/s.
        apart_m: two cameras nearer than this share a body. Judgement.
        facing_share: of marker views that must show the printed face. Judgement; a mirrored board has 0.
        upside_down_cosine: of the image's up direction with the world's. Judgement: 120 deg.
        target_spread_share: of an image's width, by which a corner must spread over the recording in some camera. Judgement: a
            hand that holds a target still sways by less.
        target_side_m: smallest and largest plausible edge of a marker or square. Prints are 10 mm to 1 m.
        distance_m: smallest and largest plausible distance between target and cameras, of rooms in which people move.
    """

    corner_spread_px_per_1000: float = 1.5
    segments: int = 10
    segment_views: int = 6
    segment_share: float = 0.5
    position_sigma_share: float = 0.005
    spread_ratio: float = 1.5
    moved_sigma: float = 2.5
    turned_rad: float = float(np.deg2rad(0.35))
    focal_share: float = 0.005
    centre_rad: float = float(np.deg2rad(1.0))
    bend_px_per_1000: float = 1.0
    stretch_share: float = 0.01
    lens_sigma: float = 6.0
    own_depth_ratio: float = 1.3
    own_focal_sigma: float = 0.003
    own_bend_px_per_1000: float = 0.5
    late_s: float = 0.004
    drift: float = 1e-4
    late_sigma: float = 5.0
    apart_m: float = 0.03
    facing_share: float = 0.9
    upside_down_cosine: float = -0.5
    target_spread_share: float = 0.01
    target_side_m: tuple[float, float] = (0.004, 2.0)
    distance_m: tuple[float, float] = (0.6, 25.0)


LIMITS = Limits()
