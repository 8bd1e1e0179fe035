"""The solves behind the hypotheses: from a solution that is near, or again from changed input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posefuse.calibration.report import CheckKind
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Target
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .causes import CauseTrial, Trouble
from .pipeline import TIME_STEPS, Options, Solved, key_snapshots, link, solve_linked
from .prop_solve import Freedom, PropSolution, PropState, solve_prop


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
    options: Options = replace(trouble.options, instants=min(trouble.options.instants, TIME_STEPS), clocks=clocks)
    delay = np.zeros((len(cameras), 2)) if delay_s is None else delay_s
    seen = key_snapshots(observations, options, delay)
    if len(seen.camera) == 0:
        return None, 0
    links = link(cameras, target, seen)
    if len(links.placed) < len(cameras):
        return None, len(seen.camera)
    solved = solve_linked(observations, cameras, target, options, links, delay)
    # what is not read again at the clocks found, since a neighbouring frame lacks it, is no evidence against them
    used = np.isin(seen.instant, np.unique(solved.seen.instant)) & np.isin(seen.patch, np.unique(solved.seen.patch))
    return solved, int((~used).sum())
