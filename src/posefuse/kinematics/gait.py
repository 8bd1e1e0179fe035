"""Gait events and step measures of a walking person.

Events after Zeni, Richards & Higginson (2008): along the direction of walking, the heel is farthest ahead of the pelvis at foot
strike, the toe farthest behind at foot off. The heel is then still moving with the pelvis; a strike is therefore put where, after
that, the heel has nearly come to rest. Where a skeleton has no feet, the ankle stands for both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from posefuse.core import PoseSequence
from posefuse.core.arrays import Array, sample_sd
from posefuse.core.skeleton import SIDES

from .side_clues import landmarks

_SLOWEST_M_S = 0.25
_SMOOTH_S = 0.14
_HEADING_S = 1.0
# short enough that a curve is not cut
_PACE_S = 0.3
_SWING_M = 0.12
_RESTING = 0.3
_LANDING_S = 0.12
_LONGEST_BRIDGE_S = 0.5


@dataclass(frozen=True)
class Spread:
    """Mean, sample standard deviation (`sample_sd`) and count of a measure over steps or strides; NaN for none."""

    mean: float
    sd: float
    count: int

    @staticmethod
    def of(values: Sequence[float] | Array) -> Spread:
        """Of the values."""
        if not len(values):
            return Spread(float("nan"), float("nan"), 0)
        return Spread(float(np.mean(values)), float(sample_sd(np.asarray(values))), len(values))


@dataclass(frozen=True, eq=False, kw_only=True)
class Gait:
    """Events and measures of one person's walk.

    Attributes:
        strike_s, off_s: by side, times of foot strikes and foot offs in session seconds.
        step_length_m: by side of the leading foot, along the direction of walking, from strike to strike of the heels.
        step_width_m: across it.
        stride_length_m, stride_time_s: strike to strike of the same foot.
        stance_share: by side, share of the stride on the ground.
        double_support_share: share of the stride with both feet on the ground.
        cadence_per_min: steps per minute.
        speed_m_s: mean speed of the pelvis while walking.
    """

    strike_s: dict[str, Array]
    off_s: dict[str, Array]
    step_length_m: dict[str, Spread]
    step_width_m: Spread
    stride_length_m: Spread
    stride_time_s: Spread
    stance_share: dict[str, Spread]
    double_support_share: Spread
    cadence_per_min: float
    speed_m_s: float


@dataclass(frozen=True, eq=False, kw_only=True)
class _Walk:
    """A time without a gap (T,): direction (T, 3) of walking, velocity (T, 3) of the pelvis, heels (T, 3) by side.

    And the events, by side, of one walk in it, in which the person never stands.
    """

    t_s: Array
    ahead: Array
    pace: Array
    heels: dict[str, Array]
    strikes: dict[str, Array]
    offs: dict[str, Array]

    @cached_property
    def events(self) -> list[tuple[int, str]]:
        """Strikes of both feet, in order: time step and side."""
        return sorted((int(i), side) for side in SIDES for i in self.strikes[side])

    def between(self, begin: int, end: int) -> _Walk:
        """With the events of these time steps alone, the last one excluded."""
        strikes, offs = (
            {side: at[(at >= begin) & (at < end)] for side, at in events.items()} for events in (self.strikes, self.offs)
        )
        return replace(self, strikes=strikes, offs=offs)

    def steps(self) -> Iterator[tuple[str, float, float]]:
        """Side of the leading foot, length and width of each step, from where one heel struck to where the other did."""
        for (last, before), (i, side) in pairwise(self.events):
            if before != side:
                # not to where the other heel is by now: it has risen and moves
                gap = self.heels[side][i] - self.heels[before][last]
                width_m = abs(float(gap[0] * self.ahead[i, 1] - gap[1] * self.ahead[i, 0]))
                yield side, float(gap @ self.ahead[i]), width_m

    def strides(self) -> Iterator[tuple[float, float]]:
        """Length and time of each stride."""
        for side in SIDES:
            for a, b in pairwise(self.strikes[side]):
                along = self.heels[side][b] - self.heels[side][a]
                yield float(np.linalg.norm(along[:2])), float(self.t_s[b] - self.t_s[a])


def gait_from_poses(sequence: PoseSequence, person: int = 0) -> Gait | None:
    """Events and measures of the person at this place of axis N; None if they do not walk (two strikes of each foot).

    No step is measured across a rest, or a time in which the person, or a foot, is out of sight for more than half a second.
    """
    t_s = sequence.t_ns * 1e-9
    points = landmarks(sequence.xyz_world[:, person], sequence.skeleton)
    known = {name: np.isfinite(xyz[:, 0]) for name, xyz in points.items()}
    feet = [known[f"{side}_heel"] | known[f"{side}_ankle"] for side in SIDES]
    there = np.flatnonzero(np.all([known["left_hip"], known["right_hip"], *feet], axis=0))
    pieces = np.split(there, np.flatnonzero(np.diff(t_s[there]) > _LONGEST_BRIDGE_S) + 1)
    walks: list[_Walk] = []
    for piece in pieces:
        part = slice(piece[0], piece[-1] + 1) if len(piece) else slice(0)
        walks += _walks(t_s[part], {name: xyz[part] for name, xyz in points.items()})
    enough = all(sum(len(walk.strikes[side]) for walk in walks) >= 2 for side in SIDES)
    return _gait(walks) if enough else None


def _gait(walks: Sequence[_Walk]) -> Gait:
    steps, strides = [one for walk in walks for one in walk.steps()], [one for walk in walks for one in walk.strides()]
    ends = [(walk.events[0][0], walk.events[-1][0]) for walk in walks]
    lasts_s = sum(float(walk.t_s[last] - walk.t_s[first]) for walk, (first, last) in zip(walks, ends, strict=True))
    paces = [walk.pace[first : last + 1, :2] for walk, (first, last) in zip(walks, ends, strict=True)]
    both = [share for walk in walks for share in _double_supports(walk.t_s, walk.strikes, walk.offs)]
    return Gait(
        strike_s={side: np.concatenate([walk.t_s[walk.strikes[side]] for walk in walks]) for side in SIDES},
        off_s={side: np.concatenate([walk.t_s[walk.offs[side]] for walk in walks]) for side in SIDES},
        step_length_m={side: Spread.of([length_m for leading, length_m, _ in steps if leading == side]) for side in SIDES},
        step_width_m=Spread.of([width_m for _, _, width_m in steps]),
        stride_length_m=Spread.of([length_m for length_m, _ in strides]),
        stride_time_s=Spread.of([time_s for _, time_s in strides]),
        stance_share={side: Spread.of([share for walk in walks for share in _stances(walk, side)]) for side in SIDES},
        double_support_share=Spread.of(both),
        cadence_per_min=60.0 * sum(len(walk.events) - 1 for walk in walks) / lasts_s,
        speed_m_s=float(np.concatenate([np.linalg.norm(path, axis=-1) for path in paces]).mean()),
    )


def _walks(t_s: Array, seen: dict[str, Array]) -> list[_Walk]:
    if len(t_s) < 8 or np.ptp(t_s) < 1.0:
        return []
    points = {name: _bridged(xyz, t_s) for name, xyz in seen.items()}
    hips = (points["left_hip"] + points["right_hip"]) / 2
    rate_hz = (len(t_s) - 1) / float(np.ptp(t_s))
    velocity, ahead = _walking(hips, t_s, rate_hz)
    moving = np.linalg.norm(velocity[:, :2], axis=-1) > _SLOWEST_M_S
    if not moving.any():
        return []
    strikes, offs, heels = (dict[str, Array]() for _ in range(3))
    for side in SIDES:
        heels[side], toe = _foot(points, side)
        tops = _peaks(((heels[side] - hips) * ahead).sum(-1), moving, rate_hz)
        strikes[side] = _landed(tops, heels[side], ahead, velocity, t_s, rate_hz)
        offs[side] = _peaks(-((toe - hips) * ahead).sum(-1), moving, rate_hz)
    pace, _ = _walking(hips, t_s, rate_hz, _PACE_S)
    whole = _Walk(t_s=t_s, ahead=ahead, pace=pace, heels=heels, strikes=strikes, offs=offs)
    walks = [whole.between(*ends) for ends in pairwise([0, *_begins(moving), len(t_s)])]
    return [walk for walk in walks if any(walk.strides())]


def _begins(moving: Array) -> Array:
    """Time steps at which a person walks again who had stood."""
    at = np.flatnonzero(moving)
    return np.asarray(at[1:][np.diff(at) > 1])


def _walking(hips: Array, t_s: Array, rate_hz: float, over_s: float = _HEADING_S) -> tuple[Array, Array]:
    """Velocity (T, 3) of the pelvis, averaged over a time, and its horizontal unit direction."""
    window = max(3, 2 * int(over_s * rate_hz / 2) + 1)
    # times with the points: where a live session skipped time steps, both are averaged over the same ones
    padded = np.pad(np.column_stack([hips, t_s]), ((window // 2, window // 2), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = np.stack([np.convolve(column, np.full(window, 1 / window), "valid") for column in padded.T], axis=-1)
    velocity = np.gradient(smooth[:, :3], smooth[:, 3], axis=0)
    level = velocity * [1, 1, 0]
    return velocity, level / np.maximum(np.linalg.norm(level, axis=-1, keepdims=True), 1e-9)


def _foot(points: dict[str, Array], side: str) -> tuple[Array, Array]:
    heel, toe, ankle = (points[f"{side}_{name}"] for name in ("heel", "toe", "ankle"))
    return (heel if np.isfinite(heel).all() else ankle), (toe if np.isfinite(toe).all() else ankle)


def _bridged(xyz: Array, t_s: Array) -> Array:
    """Gaps filled linearly over time, for events only; all NaN stays so."""
    seen = np.isfinite(xyz[:, 0])
    if seen.all() or not seen.any():
        return xyz
    return np.stack([np.interp(t_s, t_s[seen], xyz[seen, i]) for i in range(3)], axis=-1)


def _peaks(signal: Array, moving: Array, rate_hz: float) -> Array:
    """Indices of the maximum of each swing while walking; not at the very ends, where it may be a cut."""
    # not with the other imports: every summary of a run would take a third of a second and 28 MiB for it
    from scipy.signal import find_peaks

    if not np.isfinite(signal).all():
        return np.zeros(0, np.intp)
    found, _ = find_peaks(_smooth(signal, rate_hz), prominence=_SWING_M)
    return np.asarray(found[moving[found]])


def _smooth(signal: Array, rate_hz: float) -> Array:
    from scipy.signal import savgol_filter

    window = max(5, 2 * int(_SMOOTH_S * rate_hz / 2) + 1)
    return np.asarray(savgol_filter(signal, min(window, len(signal) - 1 + len(signal) % 2), 2))


def _landed(tops: Array, heel: Array, ahead: Array, velocity: Array, t_s: Array, rate_hz: float) -> Array:
    """The first time step after each top at which the heel moves over the ground at less than a part of walking speed."""
    if not len(tops):
        return tops
    forward = (np.gradient(heel, t_s, axis=0) * ahead).sum(-1)
    still = _smooth(forward, rate_hz) < _RESTING * np.linalg.norm(velocity[:, :2], axis=-1)
    within = int(_LANDING_S * rate_hz) + 1
    return np.array([top + (int(np.argmax(still[top : top + within])) if still[top : top + within].any() else 0) for top in tops])


def _stances(walk: _Walk, side: str) -> list[float]:
    shares, strikes, offs = [], walk.t_s[walk.strikes[side]], walk.t_s[walk.offs[side]]
    for begin, end in pairwise(strikes):
        between = offs[(offs > begin) & (offs < end)]
        if len(between) == 1:
            shares.append(float((between[0] - begin) / (end - begin)))
    return shares


def _double_supports(t_s: Array, strikes: dict[str, Array], offs: dict[str, Array]) -> list[float]:
    """Of each stride of either foot: from its strike to the other's foot off, and from the other's strike to its own foot off."""
    shares = []
    for side, other in (SIDES, SIDES[::-1]):
        for begin, end in pairwise(strikes[side]):
            events = [places[(places > begin) & (places < end)] for places in (offs[other], strikes[other], offs[side])]
            if all(len(inside) == 1 for inside in events):
                (other_off,), (other_strike,), (own_off,) = events
                both = t_s[other_off] - t_s[begin] + t_s[own_off] - t_s[other_strike]
                shares.append(float(both / (t_s[end] - t_s[begin])))
    return shares
