"""What refuses a calibration: every threshold with its unit and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Limits:
    """Thresholds of the checks of a rig from a prop or board.

    "bench" is `bench/calibration_faults.py`. Judgement: set by the author. No fault there fails `halves_*`, `inlier_share`,
    `corner_spread` or `apart_m` alone, and none fails `own_*`, which have tests only.

    Attributes:
        corner_spread_px_per_1000: of a corner coordinate, per 1000 px of image width. Detection leaves 0.1 to 0.4 (docs).
        inlier_share: of each camera's marker views that must agree. Judgement; good sessions have 0.9 or more (bench).
        segments, segment_views, segment_share: the recording is cut into so many parts; a part of a camera with so many views
            must agree by this share. Judgement.
        position_sigma_share: standard error of a camera's position over the target's usual distance. Judgement: 20 mm of 4 m.
        halves_share, halves_most_share, halves_sigma: two solves without common data may differ by so many standard errors,
            within these shares of the distance. Real lenses deviate alike in neighbouring views (four webcams of `caliscope`).
        halves_rad: and by this angle. From the same webcams.
        spread_ratio: of residuals in one rig to those in a rig for each half. Bench: 1.1 in good sessions.
        moved_sigma, moved_share, moved_rad: a spread ratio above its limit refuses only with a pose that differs between the
            halves by so many standard errors, and by this share of the distance or this angle. The webcams: 2 sigma.
        strong_ratio, strong_sigma: a ratio this far above its limit, which noise alone does not reach, refuses with poses that
            differ by fewer standard errors. Judgement: twice as far above 1 as the webcams, and more than their 2 sigma.
        certain_ratio, certain_sigma, certain_share, certain_rad: and so does a smaller spread ratio with poses that differ this
            clearly and by this much, which is what a camera that was moved does to a user. Bench: 1.1 in good sessions.
        effect_share: a spread ratio above its limit refuses without regard to standard errors where poses differ by what moves
            points at the target's distance by this share. Judgement: as focal_share. The webcams differ by 0.007, their ratio is
            1.24.
        focal_share: focal lengths that are let free may change by this. Intrinsics from a board repeat to 0.1 to 0.3 % (docs).
        centre_share: and the principal point by what moves a camera by this share of the target's distance, twice what the
            focal length's limit does: two webcams whose rig is right show 0.7 %, as their lens model is not quite theirs. The
            angle itself is taken up by the camera's rotation.
        bend_px_per_1000: and image points at the rim by distortion, per 1000 px of width. Judgement.
        stretch_share: a board may be longer in one direction by this: printers are true to 0.5 %.
        lens_sigma: none of the four refuses below so many standard errors.
        own_depth_ratio, own_focal_sigma, own_bend_px_per_1000: intrinsics from the recording of the extrinsics need a target that
            was so much farther away at times, and standard errors of focal length (share) and distortion at the rim below these.
            Judgement: what a board gives (0.1 to 0.3 %), and the limits above.
        late_s, late_sigma: clocks of synchronised cameras. 4 ms is 4 mm at 1 m/s.
        apart_m: two cameras nearer than this share a body. Judgement.
        facing_share: of marker views that must show the printed face. Judgement; a mirrored board has 0.
        upside_down_cosine: of the image's up direction with the world's. Judgement: 120 deg.
        target_spread_share: of an image's width, by which a corner must spread over the recording in some camera. Judgement: a
            hand that holds a target still sways by less.
        target_side_m: smallest and largest plausible edge of a marker or square. Prints are 10 mm to 1 m.
        distance_m: smallest and largest plausible distance between target and cameras, of rooms in which people move.
    """

    corner_spread_px_per_1000: float = 1.5
    inlier_share: float = 0.7
    segments: int = 10
    segment_views: int = 6
    segment_share: float = 0.5
    position_sigma_share: float = 0.005
    halves_share: float = 0.003
    halves_most_share: float = 0.012
    halves_sigma: float = 30.0
    halves_rad: float = float(np.deg2rad(0.6))
    spread_ratio: float = 1.35
    moved_sigma: float = 5.0
    moved_share: float = 0.0005
    moved_rad: float = float(np.deg2rad(0.03))
    strong_ratio: float = 1.5
    strong_sigma: float = 2.5
    certain_ratio: float = 1.12
    certain_sigma: float = 8.0
    certain_share: float = 0.0025
    certain_rad: float = float(np.deg2rad(0.1))
    effect_share: float = 0.005
    focal_share: float = 0.005
    centre_share: float = 0.01
    bend_px_per_1000: float = 1.0
    stretch_share: float = 0.01
    lens_sigma: float = 6.0
    own_depth_ratio: float = 1.3
    own_focal_sigma: float = 0.003
    own_bend_px_per_1000: float = 0.5
    late_s: float = 0.004
    late_sigma: float = 5.0
    apart_m: float = 0.03
    facing_share: float = 0.9
    upside_down_cosine: float = -0.5
    target_spread_share: float = 0.01
    target_side_m: tuple[float, float] = (0.004, 2.0)
    distance_m: tuple[float, float] = (0.6, 25.0)


LIMITS = Limits()
