"""A suit of 17 inertial sensors, simulated from the truth and integrated as such suits do.

Each segment carries a sensor whose fused orientation errs: a mounting error, a slowly wandering heading (gyroscope bias and
magnetic disturbance), and noise. The suit has no eyes: it chains segments of known length from the foot that stands, which it
takes to be at rest (zero-velocity update), so the body's place is the sum of all steps so far, and every error of heading
bends the way.

Figures, all published (MTw Awinda user manual, sensor specification; Paulich et al. 2018, "Xsens MTw Awinda"): dynamic accuracy
0.75 deg RMS in roll and pitch, 1.5 deg RMS in heading, gyroscope bias instability 10 deg/h. How such suits place the body
step by step: Roetenberg, Luinge, Slycke 2009, "Xsens MVN". Ours to choose, and stated in `SuitNoise`: how fast a heading wanders
within its error, mounting, segment lengths, slip of the standing foot.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posefuse.core import ConfigError, Truth
from posefuse.core.arrays import Array
from posefuse.core.errors import choices
from posefuse.core.skeleton import pick_keypoints

# pelvis, sternum, head, and per side: shoulder, upper arm, forearm, hand, thigh, shank, foot
SENSORS = 17
_CHAIN = (("ankle", "knee"), ("knee", "hip"))
_SIDES = ("left", "right")


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


def suit_pelvis(truth: Truth, noise: SuitNoise | None = None, seed: int = 0) -> Array:
    """The middle of the hips (T, 3) as the suit tells it, in world metres; it begins where the truth does.

    Args:
        truth: of one person, with ankles, knees and hips.
        noise: of the sensors.
        seed: of everything drawn.

    Raises:
        ConfigError: a keypoint is missing.
    """
    noise = noise or SuitNoise()
    rng = np.random.default_rng(seed)
    names = [f"{side}_{joint}" for side in _SIDES for joint in ("ankle", "knee", "hip")]
    missing = [name for name in names if name not in truth.skeleton.keypoints]
    if missing:
        raise ConfigError(f"inertial suit: the truth lacks {choices(missing)}; there are: {choices(truth.skeleton.keypoints)}")
    t_s = (truth.t_ns - truth.t_ns[0]) / 1e9
    points = {name: pick_keypoints(truth.xyz_world[:, 0], truth.skeleton, [name])[:, 0] for name in names}
    suit_turn = np.deg2rad(rng.normal(0, noise.bias_deg_per_h)) / 3600 * t_s
    pelvis_from_ankle = {side: _leg(points, side, t_s, suit_turn, noise, rng) for side in _SIDES}
    return _stepped(points, pelvis_from_ankle, noise, rng)


def standing_side(left_ankle: Array, right_ankle: Array) -> Array:
    """(T,) 0 while the left foot stands, 1 while the right one does: the lower, slower one, held through a few instants."""
    speed = [np.linalg.norm(np.gradient(ankle, axis=0), axis=-1) for ankle in (left_ankle, right_ankle)]
    raw = speed[0] > speed[1]
    kernel = np.ones(5) / 5
    return np.asarray(np.convolve(np.pad(raw.astype(float), 2, mode="edge"), kernel, mode="valid") > 0.5).astype(int)


def _leg(points: dict[str, Array], side: str, t_s: Array, suit_turn: Array, noise: SuitNoise, rng: np.random.Generator) -> Array:
    """(T, 3) from the ankle to the middle of the hips, along bones as their sensors tell them."""
    total = np.zeros((len(t_s), 3))
    for low, high in _CHAIN:
        total += _erring(points[f"{side}_{high}"] - points[f"{side}_{low}"], t_s, suit_turn, noise, rng)
    other = "right" if side == "left" else "left"
    half_pelvis = (points[f"{other}_hip"] - points[f"{side}_hip"]) / 2
    return total + _erring(half_pelvis, t_s, suit_turn, noise, rng)


def _erring(bone: Array, t_s: Array, suit_turn: Array, noise: SuitNoise, rng: np.random.Generator) -> Array:
    """A bone (T, 3) turned by its sensor's error, of a slightly wrong length."""
    tilt = np.deg2rad(noise.tilt_deg) * _wander(t_s, 1.0, (2,), rng) + np.deg2rad(rng.normal(0, noise.mounting_deg, 2))
    heading = np.deg2rad(noise.heading_deg) * _wander(t_s, noise.heading_time_s, (1,), rng)[:, 0] + suit_turn
    small = np.concatenate([tilt, heading[:, None]], axis=-1)
    length = float(np.median(np.linalg.norm(bone, axis=-1)))
    turned = bone + np.cross(small, bone)
    turned *= np.linalg.norm(bone, axis=-1, keepdims=True) / np.linalg.norm(turned, axis=-1, keepdims=True)
    return np.asarray(turned * (1 + rng.normal(0, noise.length_m) / length))


def _wander(t_s: Array, time_s: float, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
    """(T, ...) Gauss-Markov process of unit variance and correlation time `time_s`."""
    out = np.empty((len(t_s), *shape))
    out[0] = rng.normal(size=shape)
    for i in range(1, len(t_s)):
        keep = np.exp(-(t_s[i] - t_s[i - 1]) / time_s)
        out[i] = keep * out[i - 1] + np.sqrt(1 - keep**2) * rng.normal(size=shape)
    return out


def _stepped(points: dict[str, Array], pelvis_from_ankle: dict[str, Array], noise: SuitNoise, rng: np.random.Generator) -> Array:
    """The pelvis over the standing foot; at each change of feet the new one is put where the chain says it is."""
    standing = standing_side(points["left_ankle"], points["right_ankle"])
    start = (points["left_hip"][0] + points["right_hip"][0]) / 2
    pelvis = np.empty((len(standing), 3))
    anchor = start - pelvis_from_ankle[_SIDES[standing[0]]][0]
    height = {side: points[f"{side}_ankle"][0, 2] for side in _SIDES}
    for i, foot in enumerate(standing):
        side = _SIDES[foot]
        if i and foot != standing[i - 1]:
            anchor = pelvis[i - 1] - pelvis_from_ankle[side][i - 1] + np.append(rng.normal(0, noise.slip_m, 2), 0.0)
            # the floor is known to be level
            anchor[2] = height[side]
        pelvis[i] = anchor + pelvis_from_ankle[side][i]
    return pelvis
