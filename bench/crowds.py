"""Several people against the truth: do they keep their identity? IDF1, HOTA, identity switches, misses, false people.

All of them compare whole people by one distance, the mean over the keypoints both have. IDF1 after Ristani et al. 2016, HOTA
after Luiten et al. 2021 with the similarity 1 - distance / `gate_m`, switches as in CLEAR MOT (Bernardin et al. 2008).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import linear_sum_assignment

from posefuse.core import ShapeError
from posefuse.core.arrays import Array

GATE_M = 0.5
_ALPHAS = np.arange(1, 20) / 20
_FAR_M = 1e3


@dataclass(frozen=True, kw_only=True)
class CrowdFigures:
    """How well several people were followed.

    Attributes:
        idf1, hota: 0 to 1. detection, association: the two parts of HOTA, DetA and AssA.
        switches: how often a person came under another id than before. per_person_minute: of the time people were there.
        missed: share of (person, frame) that nothing matched. false: people per true person that match no true person.
        mpjpe_mm: mean distance of the matched.
    """

    idf1: float
    hota: float
    detection: float
    association: float
    switches: int
    per_person_minute: float
    missed: float
    false: float
    mpjpe_mm: float


def person_distances(truth_xyz: Array, result_xyz: Array) -> Array:
    """(T, N, M) mean distance in metres of truth (T, N, K, 3) and result (T, M, K, 3); inf where they share no keypoint.

    Raises:
        ShapeError: other frames or keypoints.
    """
    if truth_xyz.shape[0] != result_xyz.shape[0] or truth_xyz.shape[2:] != result_xyz.shape[2:]:
        raise ShapeError(f"person_distances: expected (T, N, K, 3) and (T, M, K, 3), got {truth_xyz.shape}, {result_xyz.shape}")
    apart = np.linalg.norm(truth_xyz[:, :, None] - result_xyz[:, None], axis=-1)
    both = np.isfinite(apart)
    total = np.where(both, apart, 0.0).sum(axis=-1)
    return np.where(both.any(axis=-1), total / np.maximum(both.sum(axis=-1), 1), np.inf)


def crowd_figures(distance_m: Array, asked: Array, there: Array, rate_hz: float, gate_m: float = GATE_M) -> CrowdFigures:
    """Figures of a result.

    Args:
        distance_m: (T, N, M), see `person_distances`.
        asked: (T, N) whether the person counts in that frame. A person who is hidden from nearly all cameras does not;
            a result that follows them anyway is neither right nor wrong.
        there: (T, M) which results exist.
        rate_hz: frames per second. gate_m: farther apart, two are not the same person.
    """
    there = there & ~_on_unasked(distance_m, asked, there, gate_m)
    close = np.where(asked[:, :, None] & there[:, None], distance_m, np.inf)
    matches = _matches(close, gate_m)
    hota, detection, association = _hota(close, asked, there, gate_m)
    switches = sum(_switches(matches[:, n]) for n in range(matches.shape[1]))
    seen, matched = asked.sum(), (matches >= 0).sum()
    picked = [close[t, n, matches[t, n]] for t, n in np.argwhere(matches >= 0)]
    return CrowdFigures(
        idf1=_idf1(close, asked, there, gate_m),
        hota=hota,
        detection=detection,
        association=association,
        switches=switches,
        per_person_minute=float(switches / max(seen / rate_hz / 60, 1e-9)),
        missed=float(1 - matched / max(seen, 1)),
        false=float((there.sum() - matched) / max(seen, 1)),
        mpjpe_mm=float(1000 * np.mean(picked)) if picked else float("nan"),
    )


def returned_right(matches: Array, asked: Array, away_frames: int, settled_frames: int) -> tuple[int, int]:
    """(right, all) returns of people who were away: under the id they had in most of the frames before.

    Args:
        matches: (T, N) from `frame_matches`. asked: (T, N).
        away_frames: shorter gaps do not count. settled_frames: after so many frames the id is read, over as many.
    """
    right = total = 0
    for n in range(matches.shape[1]):
        for begin, end in _gaps(asked[:, n], away_frames):
            before = _usual(matches[:begin, n])
            after = _usual(matches[end + settled_frames : end + 2 * settled_frames, n])
            if before is not None and asked[end + settled_frames : end + 2 * settled_frames, n].any():
                total += 1
                right += before == after
    return right, total


def frame_matches(distance_m: Array, asked: Array, gate_m: float = GATE_M) -> Array:
    """(T, N) the result that each person is, -1 for none; an earlier match is kept while it is near enough (CLEAR MOT)."""
    return _matches(np.where(asked[:, :, None], distance_m, np.inf), gate_m)


def crowd_row(distance_m: Array, asked: Array, there: Array, rate_hz: float) -> dict[str, float]:
    """Figures of a result, and returns: of a person away for a second, whose id is read half a second later, over as much."""
    matches = frame_matches(distance_m, asked)
    right, returns = returned_right(matches, asked, round(rate_hz), round(rate_hz / 2))
    found = asdict(crowd_figures(distance_m, asked, there, rate_hz))
    return {**found, "returns": returns, "returns_right": right}


def _usual(matches: Array) -> int | None:
    ids, counts = np.unique(matches[matches >= 0], return_counts=True)
    return int(ids[counts.argmax()]) if len(ids) else None


def _gaps(present: Array, least: int) -> list[tuple[int, int]]:
    """(begin, end) of each stretch of absence of at least `least` frames between two of presence."""
    frames = np.flatnonzero(present)
    return [(int(a) + 1, int(b)) for a, b in pairwise(frames) if b - a - 1 >= least]


def _on_unasked(distance_m: Array, asked: Array, there: Array, gate_m: float) -> Array:
    """(T, M) results of people who are not evaluated: nearer to one of those than to any evaluated person."""
    hidden = np.where(asked[:, :, None], np.inf, distance_m).min(axis=1, initial=np.inf)
    counted = np.where(asked[:, :, None], distance_m, np.inf).min(axis=1, initial=np.inf)
    return np.asarray(there & (hidden < gate_m) & (hidden < counted))


def _matches(close: Array, gate_m: float) -> Array:
    found = np.full(close.shape[:2], -1)
    last = np.full(close.shape[1], -1)
    for t, cost in enumerate(close):
        held = [n for n in range(len(cost)) if last[n] >= 0 and cost[n, last[n]] < gate_m]
        found[t, held] = last[held]
        open_n = [n for n in range(len(cost)) if n not in held]
        open_m = [m for m in range(cost.shape[1]) if m not in set(last[held])]
        for a, b in _paired(np.minimum(cost[np.ix_(open_n, open_m)], _FAR_M)):
            if cost[open_n[a], open_m[b]] < gate_m:
                found[t, open_n[a]] = last[open_n[a]] = open_m[b]
    return found


def _switches(matches: Array) -> int:
    ids = matches[matches >= 0]
    return int((np.diff(ids) != 0).sum())


def _idf1(close: Array, asked: Array, there: Array, gate_m: float) -> float:
    common = (close < gate_m).sum(axis=0)
    right = sum(common[n, m] for n, m in _paired(-common))
    return float(2 * right / max(asked.sum() + there.sum(), 1))


def _hota(close: Array, asked: Array, there: Array, gate_m: float) -> tuple[float, float, float]:
    alike = np.clip(1 - close / gate_m, 0.0, 1.0)
    usual = _usual_partner(alike, asked, there)
    counts = np.zeros((len(_ALPHAS), *close.shape[1:]))
    for now in alike:
        for n, m in _paired(-now * usual):
            counts[:, n, m] += now[n, m] >= _ALPHAS
    true = counts.sum(axis=(1, 2))
    detection = true / np.maximum(asked.sum() + there.sum() - true, 1)
    either = asked.sum(axis=0)[:, None] + there.sum(axis=0) - counts
    association = (counts * counts / np.maximum(either, 1)).sum(axis=(1, 2)) / np.maximum(true, 1)
    return float(np.sqrt(detection * association).mean()), float(detection.mean()), float(association.mean())


def _usual_partner(alike: Array, asked: Array, there: Array) -> Array:
    """(N, M) how well two tracks fit over the whole recording; breaks ties of single frames in favour of pairs that persist."""
    either = alike.sum(axis=1, keepdims=True) + alike.sum(axis=2, keepdims=True) - alike
    shared = np.where(either > 0, alike / np.maximum(either, 1e-12), 0.0).sum(axis=0)
    return np.asarray(shared / np.maximum(asked.sum(axis=0)[:, None] + there.sum(axis=0) - shared, 1e-12))


def _paired(cost: Array) -> list[tuple[int, int]]:
    rows, columns = linear_sum_assignment(cost)
    return list(zip(rows.tolist(), columns.tolist(), strict=True))
