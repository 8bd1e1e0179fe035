"""A suit of 17 inertial sensors, simulated from the truth and integrated as such suits do.

Each segment carries a sensor whose fused orientation errs: a mounting error, a slowly wandering heading (gyroscope bias and
magnetic disturbance), and noise. The suit has no eyes: it chains segments of known length from the point of the feet that
stands, which it takes to be at rest (zero-velocity update), so the body's place is the sum of all steps so far, and every
error of heading bends the way.

Figures, all published (MTw Awinda user manual, sensor specification; Paulich et al. 2018, "Xsens MTw Awinda"): dynamic accuracy
0.75 deg RMS in roll and pitch, 1.5 deg RMS in heading, gyroscope bias instability 10 deg/h. How such suits place the body
step by step: Roetenberg, Luinge, Slycke 2009, "Xsens MVN". Ours to choose, and stated in `SuitNoise`: how fast a heading wanders
within its error, mounting, segment lengths, slip of the standing foot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import PAPER14, Array, ConfigError, Truth, choices, pick_keypoints
from posefuse.evaluation import drift as drift_of

_SIDES = ("left", "right")
_SOLES = tuple(f"{side}_{part}" for side in _SIDES for part in ("heel", "big_toe"))
# segment -> joints it holds apart, outward from the pelvis
_BONES = {
    "pelvis": (("mid_hip", "left_hip"), ("mid_hip", "right_hip")),
    **{f"{side}_thigh": ((f"{side}_hip", f"{side}_knee"),) for side in _SIDES},
    **{f"{side}_shank": ((f"{side}_knee", f"{side}_ankle"),) for side in _SIDES},
    **{f"{side}_foot": tuple((f"{side}_ankle", f"{side}_{part}") for part in ("heel", "big_toe")) for side in _SIDES},
    "trunk": (("mid_hip", "neck"),),
    **{f"{side}_collar": (("neck", f"{side}_shoulder"),) for side in _SIDES},
    **{f"{side}_upper_arm": ((f"{side}_shoulder", f"{side}_elbow"),) for side in _SIDES},
    **{f"{side}_forearm": ((f"{side}_elbow", f"{side}_wrist"),) for side in _SIDES},
}


@dataclass(frozen=True)
class SuitNoise:
    """What the sensors' fused orientations err by, one standard deviation.

    Attributes:
        tilt_deg: roll and pitch. heading_deg: heading, wandering with `heading_time_s`. bias_deg_per_h: heading rate of the
            whole suit that nothing corrects. mounting_deg: sensor against bone, constant.
        length_m: error of each measured segment length. slip_m: how far a foot taken to stand moves in a step.
    """

    tilt_deg: float = 0.75
    heading_deg: float = 1.5
    heading_time_s: float = 20.0
    bias_deg_per_h: float = 10.0
    mounting_deg: float = 1.0
    length_m: float = 0.005
    slip_m: float = 0.003


@dataclass(frozen=True, eq=False)
class _Body:
    """Times (T,) in seconds, where the body faces (T,) and how far the whole suit's heading has turned away (T,), radians."""

    t_s: Array
    facing_rad: Array
    suit_turn_rad: Array


def suit_joints(truth: Truth, noise: SuitNoise | None = None, seed: int = 0) -> Array:
    """The paper's 14 joints (T, 14, 3) as the suit reports them, in world metres; it begins where the truth does.

    Args:
        truth: of one person, with the joints, heels and big toes.
        noise: of the sensors.
        seed: of everything drawn.

    Raises:
        ConfigError: a keypoint is missing.
    """
    noise = noise or SuitNoise()
    rng = np.random.default_rng(seed)
    points = _points(truth)
    t_s = (truth.t_ns - truth.t_ns[0]) / 1e9
    suit_turn = np.deg2rad(rng.normal(0, noise.bias_deg_per_h)) / 3600 * t_s
    across = points["left_hip"] - points["right_hip"]
    body = _Body(t_s, np.arctan2(-across[:, 0], across[:, 1]), suit_turn)
    from_pelvis = _chained(points, body, noise, rng)
    pelvis = _stepped(points, from_pelvis, noise, rng)
    return np.stack([pelvis + from_pelvis[joint] for joint in PAPER14.keypoints], axis=1)


def _points(truth: Truth) -> dict[str, Array]:
    """(T, 3) of every joint and sole of the chain."""
    names = (*PAPER14.keypoints, *_SOLES)
    # midpoints are made of these
    wanted = [name for name in names if name not in ("neck", "mid_hip")]
    missing = [name for name in wanted if name not in truth.skeleton.keypoints]
    if missing:
        raise ConfigError(f"inertial suit: the truth lacks {choices(missing)}; there are: {choices(truth.skeleton.keypoints)}")
    return {name: pick_keypoints(truth.xyz_world[:, 0], truth.skeleton, [name])[:, 0] for name in names}


def standing_point(points: Array) -> Array:
    """(T,) which of the points (T, P, 3) of the feet is slowest, that is stands."""
    speed = np.linalg.norm(np.gradient(points, axis=0), axis=-1)
    return np.asarray(speed.argmin(axis=1))


def _chained(points: dict[str, Array], body: _Body, noise: SuitNoise, rng: np.random.Generator) -> dict[str, Array]:
    """(T, 3) from the middle of the hips to every joint and sole, along bones oriented by their segments' sensors."""
    found = {"mid_hip": np.zeros((len(body.t_s), 3))}
    for bones in _BONES.values():
        sensor = _sensor(body, noise, rng)
        for near, far in bones:
            found[far] = found[near] + _erring(points[far] - points[near], *sensor)
    return found


def _sensor(body: _Body, noise: SuitNoise, rng: np.random.Generator) -> tuple[Array, float]:
    """How a segment's sensor errs: a small rotation (T, 3) in world axes, and metres by which its length was measured wrong.

    What is mounted askew turns with the body.
    """
    ahead, aside = np.deg2rad(rng.normal(0, 1, 2) * noise.mounting_deg)
    cos, sin = np.cos(body.facing_rad), np.sin(body.facing_rad)
    mounting = np.stack([ahead * cos - aside * sin, ahead * sin + aside * cos], axis=-1)
    tilt = np.deg2rad(noise.tilt_deg) * wander(body.t_s, 1.0, (2,), rng) + mounting
    heading = np.deg2rad(noise.heading_deg) * wander(body.t_s, noise.heading_time_s, (1,), rng)[:, 0] + body.suit_turn_rad
    return np.concatenate([tilt, heading[:, None]], axis=-1), float(rng.normal() * noise.length_m)


def _erring(bone: Array, small_turn: Array, longer_m: float) -> Array:
    """A bone (T, 3) turned by a small rotation (T, 3), and longer in proportion."""
    length = float(np.median(np.linalg.norm(bone, axis=-1)))
    turned = bone + np.cross(small_turn, bone)
    turned *= np.linalg.norm(bone, axis=-1, keepdims=True) / np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.asarray(turned * (1 + longer_m / length))


def wander(t_s: Array, time_s: float, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """(T, ...) Gauss-Markov process of unit variance and correlation time `time_s`."""
    out = np.empty((len(t_s), *shape))
    out[0] = rng.normal(size=shape)
    for i in range(1, len(t_s)):
        keep = np.exp(-(t_s[i] - t_s[i - 1]) / time_s)
        out[i] = keep * out[i - 1] + np.sqrt(1 - keep**2) * rng.normal(size=shape)
    return out


def _stepped(points: dict[str, Array], from_pelvis: dict[str, Array], noise: SuitNoise, rng: np.random.Generator) -> Array:
    """The pelvis over the standing point of the feet; when another one stands, its position follows from the chain."""
    standing = standing_point(np.stack([points[name] for name in _SOLES], axis=1))
    # the floor is known to be level
    height = {name: float(np.percentile(points[name][:, 2], 5)) for name in _SOLES}
    pelvis = np.empty((len(standing), 3))
    anchor = points["mid_hip"][0] + from_pelvis[_SOLES[standing[0]]][0]
    for i, place in enumerate(standing):
        if i and place != standing[i - 1]:
            name, before = _SOLES[place], _SOLES[standing[i - 1]]
            slip = noise.slip_m if name.partition("_")[0] != before.partition("_")[0] else 0.0
            anchor = pelvis[i - 1] + from_pelvis[name][i - 1] + np.append(rng.normal(0, 1, 2) * slip, 0.0)
            anchor[2] = height[name]
        pelvis[i] = anchor - from_pelvis[_SOLES[place]][i]
    return pelvis


@dataclass(frozen=True, eq=False)
class Drift:
    """Error against way.

    Attributes:
        walked_m: (T,) way so far, of the truth. error_m: (T,) level distance from the truth.
        mm_per_m: slope of the least-squares line of error over way. end_m: mean error of the last tenth.
    """

    walked_m: Array
    error_m: Array
    mm_per_m: float
    end_m: float


def drift(estimate: Array, truth: Array) -> Drift:
    """Drift of level positions (T, 2 or 3) against the truth (T, 2 or 3), both in metres; NaN where missing."""
    walked, error, slope = drift_of(truth, estimate)
    last = error[-max(1, len(error) // 10) :]
    end = float(np.nanmean(last)) if np.isfinite(last).any() else float("nan")
    return Drift(walked, error, slope, end)
