"""What the error depends on: studies on oracle detections that err like the real network."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from posefuse.core import PAPER14, SE3, Array, Pose3D, PoseSequence, Rig, Truth, Views
from posefuse.evaluation import joint_distances_mm, summary
from posefuse.foundation import settings_from_mapping
from posefuse.fusion import FuseSettings, fuse
from posefuse_sim import OracleNoise, Scene, oracle_views, truth_of

# of the real network on the walking session, as shares of the person's height in the picture: the rms error of one
# coordinate, and the part of it that stays the same; shares of keypoints and of views that are something else altogether
ERROR_SHARE, BIAS_SHARE = 0.0143, 0.005
OUTLIER_SHARE, SWAP_SHARE = 0.02, 0.01
# decoding, interpolation and lens: what is left however large the person
_LEAST_PX = 0.5
_BODY_M = 1.75
_DURATION_S, _RATE_HZ, _SEED = 8.0, 10.0, 5
_LOOK_M = 1.0


@dataclass(frozen=True)
class Errors:
    """One measurement, mean over the paper's joints.

    Attributes:
        robust_mm, p95_mm: of all points that robust weights give. robust_found, score_found: shares of points given.
        robust_same_mm, score_same_mm: of the points that both give, the only fair comparison: with few views `score` is
            silent about the difficult ones.
    """

    robust_mm: float
    p95_mm: float
    robust_found: float
    score_found: float
    robust_same_mm: float
    score_same_mm: float


@dataclass(frozen=True, eq=False)
class Study:
    """Errors over one thing that is changed, everything else as in the walking experiment.

    Attributes:
        title, unit: of what is changed. x: its values. errors: at each.
    """

    title: str
    unit: str
    x: tuple[float, ...]
    errors: tuple[Errors, ...]


@dataclass(frozen=True)
class Setup:
    """One measurement: the scene's cameras, how the detector errs, and what is wrong with the rig and the clocks."""

    cameras: int = 4
    radius_m: float = 4.5
    width_px: int = 640
    outlier_share: float = OUTLIER_SHARE
    rotation_deg: float = 0.0
    position_m: float = 0.0
    offset_s: float = 0.0
    dropped: float = 0.0


STUDIES: Mapping[str, tuple[str, str, Sequence[float], Callable[[float], Setup]]] = {
    "cameras": ("cameras", "", (2, 3, 4, 6, 8, 12, 16), lambda x: Setup(cameras=int(x))),
    "radius": ("radius of the circle", "m", (2.5, 3.5, 4.5, 6, 8, 10), lambda x: Setup(radius_m=x)),
    "resolution": ("image width", "px", (160, 320, 640, 1280, 1920), lambda x: Setup(width_px=int(x))),
    "rotation": ("calibration error, rotation", "deg", (0, 0.1, 0.2, 0.5, 1, 2), lambda x: Setup(rotation_deg=x)),
    "position": ("calibration error, position", "mm", (0, 2, 5, 10, 20, 50), lambda x: Setup(position_m=x / 1000)),
    "offset": ("clock offset", "ms", (0, 5, 10, 20, 33, 66), lambda x: Setup(offset_s=x / 1000)),
    "dropped": ("dropped frames", "%", (0, 5, 10, 20, 40), lambda x: Setup(dropped=x / 100)),
    "outliers": ("outliers", "%", (0, 2, 5, 10, 20, 30), lambda x: Setup(outlier_share=x / 100)),
}


def run_study(name: str, quick: bool = False, fusing: FuseSettings | None = None) -> Study:
    """Run one of `STUDIES`; `quick` takes its first and last value for a second of walking."""
    title, unit, values, setup_of = STUDIES[name]
    x = (values[0], values[-1]) if quick else tuple(values)
    errors = tuple(measure(setup_of(value), 1.0 if quick else _DURATION_S, fusing) for value in x)
    return Study(title, unit, tuple(map(float, x)), errors)


def measure(setup: Setup, duration_s: float = _DURATION_S, fusing: FuseSettings | None = None) -> Errors:
    """Errors of robust and score weights on the same detections."""
    fusing = fusing or FuseSettings()
    truth = _truth(setup, duration_s)
    noise = _noise(setup, truth)
    seen = oracle_views(truth, noise, _SEED)
    rng = np.random.default_rng(_SEED)
    xy, score, sigma = np.array(seen.xy_img), np.array(seen.score), np.array(seen.sigma_px)
    lost = rng.random(score.shape[:3]) < setup.dropped
    xy[lost], score[lost], sigma[lost] = np.nan, 0.0, np.nan
    rig = _disturbed(truth.rig, setup, rng)
    distances_mm = []
    for weights in ("robust", "score"):
        poses: list[Pose3D] = []
        for i, t_ns in enumerate(truth.t_ns):
            views = Views(
                t_ns=int(t_ns),
                skeleton=truth.skeleton,
                camera_names=rig.names,
                person_id=truth.person_id,
                xy_img=xy[i],
                score=score[i],
                sigma_px=sigma[i],
            )
            poses.append(fuse(views, rig, replace(fusing, weights=weights), poses[-1] if poses else None))
        distances_mm.append(joint_distances_mm(PoseSequence.from_poses(poses), truth))
    return _errors(*distances_mm)


def _errors(robust_mm: Array, score_mm: Array) -> Errors:
    both = np.isfinite(robust_mm) & np.isfinite(score_mm)
    robust, score = (summary(PAPER14.keypoints, distance_mm) for distance_mm in (robust_mm, score_mm))
    same = [summary(PAPER14.keypoints, np.where(both, distance_mm, np.nan)).mpjpe_mm for distance_mm in (robust_mm, score_mm)]
    found = [float(np.mean(errors.found)) for errors in (robust, score)]
    return Errors(robust.mpjpe_mm, float(np.nanmean(robust.p95_mm)), *found, *same)


def _truth(setup: Setup, duration_s: float) -> Truth:
    overrides: dict[str, Any] = {}
    if setup.offset_s:
        # the cameras' clocks are late by turns: what they call now is earlier or later
        overrides = {f"cam{c:02d}": {"sensor": {"phase_s": setup.offset_s * (c % 2)}} for c in range(setup.cameras)}
    image = {"size_px": [setup.width_px, setup.width_px * 3 // 4], "horizontal_fov_deg": 66}
    content = {
        "duration_s": duration_s,
        "rate_hz": _RATE_HZ,
        "seed": _SEED,
        "cameras": {
            "kind": "ring", "count": setup.cameras, "radius_m": setup.radius_m, "height_m": 2.2, "image": image,
            "overrides": overrides,
        },
        "people": [{"motion": {"kind": "walk", "speed_mps": 1.35, "path": {"shape": "circle", "radius_m": 1.0}}}],
    }  # fmt: skip
    return truth_of(settings_from_mapping(content, Scene, where="study"))


def _noise(setup: Setup, truth: Truth) -> OracleNoise:
    distance = np.median([np.linalg.norm(camera.centre_world - [0, 0, _LOOK_M]) for camera in truth.rig])
    height_px = float(truth.rig.cameras[0].K[1, 1] * _BODY_M / distance)
    return OracleNoise(
        sigma_px=float(np.hypot(ERROR_SHARE * height_px, _LEAST_PX)),
        bias_px=BIAS_SHARE * height_px,
        outlier_share=setup.outlier_share,
        outlier_px=0.25 * height_px,
        swap_share=SWAP_SHARE,
    )


def _disturbed(rig: Rig, setup: Setup, rng: np.random.Generator) -> Rig:
    """The rig as a person calibrated it: every camera turned and moved by a random error of the given size per axis."""
    cameras = []
    for camera in rig:
        turn, shift = rng.normal(size=3), rng.normal(size=3)
        if setup.rotation_deg or setup.position_m:
            wrong = SE3.from_rotvec(np.deg2rad(setup.rotation_deg) * turn, np.zeros(3))
            moved = SE3(camera.cam_from_world.wxyz, camera.cam_from_world.xyz + setup.position_m * shift)
            camera = replace(camera, cam_from_world=wrong @ moved)
        cameras.append(camera)
    return replace(rig, cameras=tuple(cameras))


def study_figures(study: Study) -> dict[str, Any]:
    """Plain figures."""
    return {
        "title": f"{study.title}{f' ({study.unit})' if study.unit else ''}",
        "x": list(study.x),
        **{field.name: [getattr(one, field.name) for one in study.errors] for field in fields(Errors)},
    }
