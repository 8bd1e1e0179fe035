"""From observations of a prop to a solved rig: key time steps, rough answer, bundle adjustment, clocks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.solving.projection import Lenses
from posefuse.calibration.solving.rotations import Poses, stacked
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.kinds import Target, patch_corners
from posefuse.core import Camera, ConfigError
from posefuse.core.arrays import Array

from .bootstrap import (
    Edge,
    PropShape,
    PropViews,
    camera_edges,
    planar_views,
    prop_track,
    prop_views,
    rough_offsets,
    shape_of,
    strong_camera_edges,
    tree,
)
from .prop_solve import Freedom, PropSolution, PropState, solve_prop
from .snapshots import Snapshots, evenly, middle_ns, pick_time_steps, snapshots

LEAST_TIME_STEPS = 8
_MOST_CLOCK_ROUNDS = 5
_CLOCK_SETTLED_S = 1e-4
_INLIER_SIGMA = 4.0
_LEAST_PATCH_SHARE = 0.6
# time steps that are enough to distinguish hypotheses
TIME_STEPS = 100
CLOCK_MODES = ("auto", "together", "offset", "drift")


@dataclass(frozen=True)
class Options:
    """How to solve.

    Attributes:
        time steps: key time steps used at most.
        clocks: ``together`` (the cameras are synchronised), ``offset`` or ``drift`` (estimate each camera's clock),
            ``auto`` (taken as synchronised, and estimated when they turn out not to be).
        lens_sigma: standard errors (6,) of `LENS_PARAMETERS` to refine the intrinsics by; None keeps them.
        own_intrinsics: the intrinsics come from the same recording, which has to carry them.
        any_size: also a rig far smaller or larger than a room.
    """

    time_steps: int = 400
    clocks: str = "auto"
    lens_sigma: tuple[float, ...] | None = None
    own_intrinsics: bool = False
    any_size: bool = False

    def __post_init__(self) -> None:
        if self.clocks not in CLOCK_MODES:
            raise ConfigError(f"clocks: expected one of {', '.join(CLOCK_MODES)}, got {self.clocks!r}")
        if self.time_steps < LEAST_TIME_STEPS:
            raise ConfigError(f"time steps: expected at least {LEAST_TIME_STEPS}, got {self.time_steps}")


@dataclass(frozen=True, eq=False)
class Links:
    """Who could be linked to whom before the solve.

    Attributes:
        edges: per camera pair i < j, how well single time steps agree. placed: cameras reached from the reference.
        reference: the camera with most agreement.
        shape: markers on the prop. seen: the corners. in_images: the prop in single images.
    """

    edges: dict[tuple[int, int], Edge]
    placed: dict[int, Poses]
    reference: int
    shape: PropShape
    seen: Snapshots
    in_images: PropViews


@dataclass(frozen=True, eq=False)
class Solved:
    """A solved rig before any check; the world is the reference camera.

    Attributes:
        seen: the corners used. corners: (M, n, 3) of each patch. links: the rough answer.
        solution: unknowns and residuals. dropped: patches (ids) left out, with the reason.
    """

    seen: Snapshots
    corners: Array
    links: Links
    solution: PropSolution
    dropped: dict[int, str]

    @property
    def inlier(self) -> Array:
        """(groups,) whether a marker in an image agrees with the solution."""
        return inlier_groups(self.seen, self.solution)


def inlier_groups(seen: Snapshots, solution: PropSolution) -> Array:
    """(groups,) every corner within 4 robust standard deviations."""
    square = np.nan_to_num(((solution.residual_px / solution.sigma_px) ** 2).mean(axis=1), nan=np.inf)
    worst = np.zeros(seen.group_count)
    np.maximum.at(worst, seen.group, square)
    return np.asarray(worst <= _INLIER_SIGMA**2)


def link(cameras: tuple[Camera, ...], target: Target, seen: Snapshots) -> Links:
    """The rough answer: markers on the prop, the prop in every image, cameras to each other."""
    corners, lenses = patch_corners(target, seen.patches), Lenses(cameras)
    views = planar_views(seen, corners, lenses)
    shape = shape_of(target, seen, views)
    in_images = prop_views(seen, views, shape, corners, lenses)
    edges = camera_edges(in_images, len(cameras))
    reference, placed = tree(len(cameras), strong_camera_edges(edges))
    return Links(edges, placed, reference, shape, seen, in_images)


def key_snapshots(observations: CornerObservations, options: Options, delay_s: Array) -> Snapshots:
    """Corners at the key time steps."""
    time_steps = pick_time_steps(observations, options.time_steps, delay_s, prefer_slow=options.clocks == "together")
    return snapshots(observations, time_steps, delay_s)


def starting_clocks(observations: CornerObservations, cameras: tuple[Camera, ...], target: Target, options: Options) -> Array:
    """(C, 2) clocks to start from: 0 for synchronised cameras, else from the paths of the prop."""
    delay_s = np.zeros((len(cameras), 2))
    if options.clocks != "together":
        delay_s[:, 0] = np.nan_to_num(rough_offsets(observations, cameras, target))
        delay_s[:, 0] -= np.median(delay_s[:, 0])
    return delay_s


def solve_linked(
    observations: CornerObservations, cameras: tuple[Camera, ...], target: Target, options: Options, links: Links, delay_s: Array
) -> Solved:
    """Bundle adjustment from the rough answer, all cameras being linked; patches that disagree are left out by name."""
    seen = links.seen
    corners, lenses = patch_corners(target, seen.patches), Lenses(cameras)
    cam_from_world = stacked([links.placed[i] for i in range(len(cameras))]).inverse()
    track = prop_track(seen, links.in_images, links.shape, corners, lenses, cam_from_world)
    known = np.asarray(np.isfinite(track.t).all(axis=1))
    placed = links.shape.prop_from_patch
    dropped = {
        int(seen.patches[i]): "never seen together with the rest of the prop, or moving independently of it"
        for i in range(len(seen.patches))
        if i not in placed
    }
    patch = stacked([placed.get(i, Poses(np.eye(3), np.zeros(3))) for i in range(len(seen.patches))])
    state = PropState.starting(cam_from_world, track, patch, delay_s)
    lens_sigma = None if options.lens_sigma is None else np.array(options.lens_sigma)
    freedom = Freedom(
        reference=links.reference,
        held_patches=links.shape.held,
        offset=options.clocks != "together",
        drift=options.clocks == "drift",
        lens_sigma=lens_sigma,
    )
    use = known[seen.time_step] & np.isin(seen.patch, list(placed))
    seen = seen.rows(use)
    solution = solve_prop(seen, corners, cameras, state, freedom)
    bad = _disagreeing_patches(seen, solution, links.shape)
    if bad:
        dropped |= {int(seen.patches[p]): f"{1 - share:.0%} of its views disagree with the prop" for p, share in bad.items()}
        seen = seen.rows(~np.isin(seen.patch, list(bad)))
        solution = solve_prop(seen, corners, cameras, solution.state, freedom)
    solved = Solved(seen, corners, links, solution, dropped)
    return _settle_clocks(observations, cameras, solved, freedom) if freedom.offset else solved


def _disagreeing_patches(seen: Snapshots, solution: PropSolution, shape: PropShape) -> dict[int, float]:
    """Patches with mostly misfitting views, with the fitting share; the held one stays, as all others are placed by it."""
    patch = seen.patch[seen.group_starts()]
    inlier = inlier_groups(seen, solution)
    count = np.bincount(patch, minlength=len(seen.patches))
    share = np.bincount(patch, inlier, len(seen.patches)) / np.maximum(count, 1)
    bad = (count > 0) & (share < _LEAST_PATCH_SHARE)
    return {int(p): float(share[p]) for p in np.flatnonzero(bad) if p != shape.held[0]}


def _settle_clocks(observations: CornerObservations, cameras: tuple[Camera, ...], solved: Solved, freedom: Freedom) -> Solved:
    """Read the corners again at the clocks found and solve again, until the clocks stay."""
    instants_ns = np.round(solved.seen.t_s * 1e9).astype(np.int64) + middle_ns(observations)
    patches, time_steps = np.unique(solved.seen.patch), np.unique(solved.seen.time_step)
    for _ in range(_MOST_CLOCK_ROUNDS):
        state = solved.solution.state
        seen = snapshots(observations, instants_ns, state.delay_s)
        seen = seen.rows(np.isin(seen.patch, patches) & np.isin(seen.time_step, time_steps))
        solved = replace(solved, seen=seen, solution=solve_prop(seen, solved.corners, cameras, state, freedom))
        if np.abs(solved.solution.state.delay_s[:, 0] - state.delay_s[:, 0]).max() < _CLOCK_SETTLED_S:
            break
    return solved


def thinned(solved: Solved) -> Solved:
    """The solution on fewer time steps: enough to distinguish hypotheses."""
    used = np.unique(solved.seen.time_step)
    rows = np.isin(solved.seen.time_step, evenly(used, TIME_STEPS))
    return replace(
        solved, seen=solved.seen.rows(rows), solution=replace(
            solved.solution, residual_px=solved.solution.residual_px[rows], weight=solved.solution.weight[rows])
    )  # fmt: skip
