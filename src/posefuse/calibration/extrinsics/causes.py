"""Why a calibration was refused: explanations tested against each other on the same corners.

A hypothesis undoes or frees one thing and solves again. All are judged by the share of the excess residual that they take
away; among those that take away about as much, the one that frees least is named. Two that cannot be separated are both named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.report import Check, CheckKind
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Target
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .pipeline import TIME_STEPS, Options, Solved, key_snapshots, link, solve_linked
from .prop_solve import Freedom, PropSolution, PropState, solve_prop

# residuals beyond so many standard deviations count ever less
_ROBUST = 3.0
# cost of a corner that the hypothesis does not explain, and of one with noise only (mean of log(1 + chi2 / 9))
_LOST, _NOISE = 3.0, 0.095
# what detection leaves of a corner: the yardstick that an explanation has to come near
_LEAST_SIGMA_PX, _MOST_SIGMA_PX = 0.1, 0.6
_LEAST_EXPLAINED, _ABOUT_AS_MUCH, _INSEPARABLE = 0.5, 0.1, 0.02
# with this share explained, no solve from the beginning is needed; an explanation that frees more is held against those
_ENOUGH, _FREES_LITTLE = 0.85, 1


@dataclass(frozen=True, eq=False)
class Trouble:
    """A calibration that was refused.

    Attributes:
        observations, cameras, target, options: its input. solved: its solution; None where the cameras could not be linked.
    """

    observations: CornerObservations
    cameras: tuple[Camera, ...]
    target: Target
    options: Options
    solved: Solved | None


@dataclass(frozen=True, eq=False)
class CauseTrial:
    """One hypothesis solved.

    Attributes:
        words: the cause, with its figures. remedy: what to do.
        camera, residual_px: (N,), (N, 2) of the corners that it placed. lost: corners that it could not place.
        frees: unknowns it has more than the solution that was refused. kind: what mends it, as in `Check`.
    """

    words: str
    remedy: str
    camera: Array
    residual_px: Array
    lost: int
    frees: int
    kind: CheckKind = "record"


@dataclass(frozen=True)
class Hypothesis:
    """An explanation.

    Attributes:
        name: in words. frees: what it undoes or frees. trials: its solves.
        near: whether they start from the solution at hand, and so take little time.
    """

    name: str
    frees: str
    trials: Callable[[Trouble], Iterable[CauseTrial]]
    near: bool


@dataclass(frozen=True, eq=False)
class Cause:
    """A hypothesis with the share (0 to 1) of the excess residual that it removes."""

    trial: CauseTrial
    explained: float
    spread_px: float


def likely_target_causes(trouble: Trouble, hypotheses: Sequence[Hypothesis]) -> tuple[Cause, ...]:
    """The best explanation, or the two best when they cannot be distinguished; none where nothing explains enough."""
    trials = [trial for hypothesis in hypotheses if hypothesis.near for trial in hypothesis.trials(trouble)]
    found = _best(trouble, trials)
    if found and found[0].explained >= _ENOUGH and found[0].trial.frees <= _FREES_LITTLE:
        return found
    return _best(
        trouble, trials + [trial for hypothesis in hypotheses if not hypothesis.near for trial in hypothesis.trials(trouble)]
    )


def _best(trouble: Trouble, trials: Sequence[CauseTrial]) -> tuple[Cause, ...]:
    if not trials:
        return ()
    base = _base(trouble)
    sigma_px = float(np.clip(min(_spread_px(trial) for trial in trials), _LEAST_SIGMA_PX, _MOST_SIGMA_PX))
    before = _cost(base, sigma_px)
    if before <= _NOISE:
        # there is no misfit to explain
        return ()
    causes = [Cause(trial, (before - _cost(trial, sigma_px)) / (before - _NOISE), _spread_px(trial)) for trial in trials]
    causes = [cause for cause in causes if cause.explained >= _LEAST_EXPLAINED]
    if not causes:
        return ()
    most = max(cause.explained for cause in causes)
    near = sorted(
        (cause for cause in causes if cause.explained >= most - _ABOUT_AS_MUCH), key=lambda c: (c.trial.frees, -c.explained)
    )
    first = near[0]
    alike = [c for c in near[1:] if c.trial.frees == first.trial.frees and c.explained >= first.explained - _INSEPARABLE]
    return (first, *alike[:1])


def cause_check(causes: Sequence[Cause], before_px: float) -> Check:
    """The causes as a failed check, with the evidence."""
    words = " or ".join(cause.trial.words for cause in causes)
    evidence = (
        f"it takes away {min(causes[0].explained, 1.0):.0%} of the misfit" if len(causes) == 1 else "the images do not show which"
    )
    spread = "" if np.isnan(before_px) else f": corners spread {causes[0].spread_px:.2f} px instead of {before_px:.2f} px"
    remedy = " or ".join(dict.fromkeys(cause.trial.remedy for cause in causes))
    return Check("cause", False, f"{words} ({evidence}{spread})", remedy, causes[0].trial.kind)


def _base(trouble: Trouble) -> CauseTrial:
    if trouble.solved is None:
        return CauseTrial("", "", np.zeros(0, np.int64), np.zeros((0, 2)), 1, 0)
    return CauseTrial("", "", trouble.solved.seen.camera, trouble.solved.solution.residual_px, 0, 0)


def base_spread_px(trouble: Trouble) -> float:
    """Usual residual of a corner coordinate in the refused solution; NaN without one."""
    return float("nan") if trouble.solved is None else _spread_px(_base(trouble))


def _spread_px(trial: CauseTrial) -> float:
    size = np.linalg.norm(trial.residual_px, axis=1)
    size = size[np.isfinite(size)]
    return float(np.median(size) / 1.1774) if len(size) else np.inf


def _cost(trial: CauseTrial, sigma_px: float) -> float:
    """Mean over the cameras of the robust cost of a corner."""
    square = np.nan_to_num((trial.residual_px**2).sum(axis=1), nan=np.inf) / (2 * sigma_px**2)
    each = np.minimum(np.log1p(square / _ROBUST**2), _LOST)
    mine = [each[trial.camera == c] for c in np.unique(trial.camera)]
    mean = float(np.mean([one.mean() for one in mine])) if mine else _LOST
    lost = trial.lost / max(trial.lost + len(each), 1)
    return (1 - lost) * mean + lost * _LOST


def near_solve(solved: Solved, cameras: tuple[Camera, ...], state: PropState, freedom: Freedom | None = None) -> PropSolution:
    """The same corners with other cameras or another start."""
    free = freedom or Freedom(reference=solved.links.reference, held_patches=solved.links.shape.held)
    return solve_prop(solved.seen, solved.corners, cameras, state, free)


def trial(
    words: str, remedy: str, solved: Solved, solution: PropSolution, frees: int, *, kind: CheckKind, lost: int = 0
) -> CauseTrial:
    """What a solve gives."""
    return CauseTrial(words, remedy, solved.seen.camera, solution.residual_px, lost, frees, kind=kind)


def solve_from_scratch(
    trouble: Trouble, observations: CornerObservations, cameras: tuple[Camera, ...], target: Target, clocks: str = "together",
    delay_s: Array | None = None,
) -> tuple[Solved | None, int]:  # fmt: skip
    """Everything from the beginning on fewer time steps: the solution, and how many corners it could not place."""
    options: Options = replace(trouble.options, time_steps=min(trouble.options.time_steps, TIME_STEPS), clocks=clocks)
    delay = np.zeros((len(cameras), 2)) if delay_s is None else delay_s
    seen = key_snapshots(observations, options, delay)
    if len(seen.camera) == 0:
        return None, 0
    links = link(cameras, target, seen)
    if len(links.placed) < len(cameras):
        return None, len(seen.camera)
    solved = solve_linked(observations, cameras, target, options, links, delay)
    # what is not read again at the clocks found, since a neighbouring frame lacks it, is no evidence against them
    used = np.isin(seen.time_step, np.unique(solved.seen.time_step)) & np.isin(seen.patch, np.unique(solved.seen.patch))
    return solved, int((~used).sum())
