"""From observations of a prop to a solved rig: key time steps, rough answer, bundle adjustment, clocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from posefuse.calibration.geometry import Lenses, Poses, stacked
from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration
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
    prop_path,
    prop_track,
    prop_views,
    rough_offsets,
    shape_of,
    strong_camera_edges,
    tree,
)
from .prop_solve import Freedom, PropState, SolvedRig, solve_prop
from .snapshots import Snapshots, evenly, middle_ns, pick_time_steps, snapshots

LEAST_TIME_STEPS = 8
_MOST_CLOCK_ROUNDS = 5
_CLOCK_SETTLED_S = 1e-4
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


@dataclass(frozen=True, eq=False)
class RigTask:
    """What is to be solved.

    Attributes:
        observations: of all cameras. cameras: in their order; their poses are not used. target: that was moved. options: how.
    """

    observations: CornerObservations
    cameras: tuple[Camera, ...]
    target: Target
    options: Options


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

    @property
    def freedom(self) -> Freedom:
        """Of the poses of cameras and patches alone."""
        return Freedom(reference=self.reference, held_patches=self.shape.held)


@dataclass(frozen=True, eq=False, kw_only=True)
class Solved(SolvedRig):
    """A rig solved from a prop; the world is the reference camera.

    Attributes:
        links: the rough answer. dropped: patches (ids) left out, with the reason. checks: that it has passed.
    """

    links: Links
    dropped: dict[int, str]
    checks: tuple[Check, ...] = ()

    @property
    def refined(self) -> tuple[Camera, ...]:
        """The cameras with their intrinsics as found."""
        lenses = Lenses(self.cameras, self.solution.state.lens_delta)
        return tuple(
            replace(camera, K=lenses.camera_matrix(i), distortion=lenses.distortion(i)) for i, camera in enumerate(self.cameras)
        )

    @property
    def distance_m(self) -> Array:
        """(N,) of the prop from the camera that sees it, of each corner."""
        seen, state = self.seen, self.solution.state
        in_cam = state.cam_from_world[seen.camera].move(state.world_from_prop.t[seen.time_step])
        return np.asarray(np.linalg.norm(in_cam, axis=1))

    @cached_property
    def thinned(self) -> Solved:
        """The solution on fewer time steps: enough to distinguish hypotheses."""
        rows = np.isin(self.seen.time_step, evenly(np.unique(self.seen.time_step), TIME_STEPS))
        less = replace(self.solution, residual_px=self.solution.residual_px[rows])
        return replace(self, seen=self.seen.rows(rows), solution=less)


def link(task: RigTask, seen: Snapshots) -> Links:
    """The rough answer: markers on the prop, the prop in every image, cameras to each other."""
    corners, lenses, count = patch_corners(task.target, seen.patches), Lenses(task.cameras), len(task.cameras)
    views = planar_views(seen, corners, lenses)
    shape = shape_of(task.target, seen, views)
    in_images = prop_views(seen, views, shape, corners, lenses)
    edges = camera_edges(in_images, count)
    reference, placed = tree(count, strong_camera_edges(edges))
    return Links(edges, placed, reference, shape, seen, in_images)


def key_snapshots(task: RigTask, delay_s: Array) -> Snapshots:
    """Corners at the key time steps."""
    options = task.options
    time_steps = pick_time_steps(task.observations, options.time_steps, delay_s, prefer_slow=options.clocks == "together")
    return snapshots(task.observations, time_steps, delay_s)


def starting_clocks(task: RigTask) -> Array:
    """(C, 2) clocks to start from: 0 for synchronised cameras, else from the paths of the prop."""
    delay_s = np.zeros((len(task.cameras), 2))
    if task.options.clocks != "together":
        delay_s[:, 0] = np.nan_to_num(rough_offsets(task.observations, task.cameras, task.target))
        delay_s[:, 0] -= np.median(delay_s[:, 0])
    return delay_s


def solve(task: RigTask, delay_s: Array) -> Solved:
    """From key time steps, read at clocks (C, 2), to the rig.

    Raises:
        RefusedCalibration: cameras that cannot be linked, or too few time steps.
    """
    seen = key_snapshots(task, delay_s)
    if len(seen.camera) == 0:
        alone = Check("cameras are linked", False, "no two cameras ever see the target at the same time",
                      "hold it where two cameras see it; are the recordings on one clock?")  # fmt: skip
        raise RefusedCalibration(CalibrationReport("extrinsics", (alone,)))
    links = link(task, seen)
    linked = check_links(task.observations.cameras, links)
    CalibrationReport("extrinsics", (linked,)).require()
    solved = solve_linked(task, links, delay_s)
    done = linked, check_amount(solved)
    CalibrationReport("extrinsics", done).require()
    return replace(solved, checks=done)


def check_links(names: Sequence[str], links: Links) -> Check:
    """All cameras hang together through time steps at which two of them see the prop and agree."""
    lost = [name for i, name in enumerate(names) if i not in links.placed]
    if not lost:
        present = np.zeros((len(links.seen.t_s), len(names)), np.int64)
        present[links.seen.time_step, links.seen.camera] = 1
        weakest = min(int(np.sort(row)[-2]) for row in present.T @ present)
        return Check("cameras are linked", True, f"every camera shares at least {weakest} key time steps with another")
    story = _link_story(names, links, lost)
    detail = f"{', '.join(lost)} cannot be linked to {', '.join(names[i] for i in sorted(links.placed))}: {story}"
    return Check(
        "cameras are linked", False, detail,
        f"hold the prop where {lost[0]} and another camera both see it for a few seconds; if they do, the cameras are"
        " unsynchronised (try clocks = offset), or an intrinsic calibration is wrong",
    )  # fmt: skip


def _link_story(names: Sequence[str], links: Links, lost: Sequence[str]) -> str:
    pairs = [
        (edge.agreeing, f"{names[a]}-{names[b]} agree in {edge.agreeing} time steps ({edge.share:.0%})")
        for (a, b), edge in links.edges.items()
        if (names[a] in lost) != (names[b] in lost)
    ]
    if not pairs:
        return "they never see the prop at the same time"
    return "; ".join(text for _, text in sorted(pairs, reverse=True)[:3])


def check_amount(solved: Solved) -> Check:
    """Enough time steps went into the solve."""
    used = len(np.unique(solved.seen.time_step))
    detail = f"{used} key time steps with 2 cameras or more (needed {LEAST_TIME_STEPS})"
    return Check("enough time steps", used >= LEAST_TIME_STEPS, detail, "wave the prop longer, where several cameras see it")


def solve_linked(task: RigTask, links: Links, delay_s: Array) -> Solved:
    """Bundle adjustment from the rough answer, all cameras being linked; patches that disagree are left out by name."""
    seen, cameras, options, placed = links.seen, task.cameras, task.options, links.shape.prop_from_patch
    corners, lenses = patch_corners(task.target, seen.patches), Lenses(cameras)
    cam_from_world = stacked([links.placed[i] for i in range(len(cameras))]).inverse()
    track = prop_track(seen, links.in_images, links.shape, corners, lenses, cam_from_world)
    known = np.asarray(np.isfinite(track.t).all(axis=1))
    dropped = {
        int(seen.patches[i]): "never seen together with the rest of the prop, or moving independently of it"
        for i in range(len(seen.patches))
        if i not in placed
    }
    patch = stacked([placed.get(i, Poses(np.eye(3), np.zeros(3))) for i in range(len(seen.patches))])
    state = PropState.starting(cam_from_world, track, patch, delay_s)
    lens_sigma = None if options.lens_sigma is None else np.array(options.lens_sigma)
    freed: dict[str, Any] = {"offset": options.clocks != "together", "drift": options.clocks == "drift", "lens_sigma": lens_sigma}
    seen = seen.rows(known[seen.time_step] & np.isin(seen.patch, list(placed)))
    freedom = replace(links.freedom, **freed)
    solution = solve_prop(seen, corners, cameras, state, freedom)
    solved = Solved(
        cameras=cameras, seen=seen, corners=corners, solution=solution, freedom=links.freedom, links=links, dropped=dropped
    )
    bad = _disagreeing_patches(solved)
    if bad:
        named = {int(seen.patches[p]): f"{1 - share:.0%} of its views disagree with the prop" for p, share in bad.items()}
        solved = replace(solved, seen=seen.rows(~np.isin(seen.patch, list(bad))), dropped=dropped | named).again(**freed)
    return _settle_clocks(task.observations, solved, freed) if freedom.offset else solved


def _disagreeing_patches(solved: Solved) -> dict[int, float]:
    """Patches with mostly misfitting views, with the fitting share; the held one stays, as all others are placed by it.

    Without this a marker that falls off half way makes the worst of three rigs 5.5 mm wrong, and with it 2.2.
    """
    seen = solved.seen
    patch = seen.patch[seen.group_starts()]
    count = np.bincount(patch, minlength=len(seen.patches))
    share = np.bincount(patch, solved.inlier, len(seen.patches)) / np.maximum(count, 1)
    bad = (count > 0) & (share < _LEAST_PATCH_SHARE)
    return {int(p): float(share[p]) for p in np.flatnonzero(bad) if p != solved.links.shape.held[0]}


def _settle_clocks(observations: CornerObservations, solved: Solved, freed: dict[str, Any]) -> Solved:
    """Read the corners again at the clocks found and solve again, until the clocks stay."""
    steps_ns = np.round(solved.seen.t_s * 1e9).astype(np.int64) + middle_ns(observations)
    patches, time_steps = np.unique(solved.seen.patch), np.unique(solved.seen.time_step)
    for _ in range(_MOST_CLOCK_ROUNDS):
        before_s = solved.solution.state.delay_s
        seen = snapshots(observations, steps_ns, before_s)
        seen = seen.rows(np.isin(seen.patch, patches) & np.isin(seen.time_step, time_steps))
        solved = _placed_again(solved, seen).again(**freed)
        if np.abs(solved.solution.state.delay_s[:, 0] - before_s[:, 0]).max() < _CLOCK_SETTLED_S:
            break
    return solved


def _placed_again(solved: Solved, seen: Snapshots) -> Solved:
    """With other snapshots of the same time steps, to start from where these show the prop where its views disagreed.

    Off by its clocks, a flat target may have come to rest in the mirrored one of the two poses that look alike.
    """
    state, wrong = solved.solution.state, np.unique(solved.seen.time_step[~solved.inlier[solved.seen.group]])
    of_these, lenses = seen.rows(np.isin(seen.time_step, wrong)), Lenses(solved.cameras, state.lens_delta)
    path = prop_path(of_these, solved.links.shape, solved.corners, lenses, state.cam_from_world)
    wrong = wrong[np.isfinite(path.t[wrong]).all(axis=1)]
    R, t = state.world_from_prop.R.copy(), state.world_from_prop.t.copy()
    R[wrong], t[wrong] = path.R[wrong], path.t[wrong]
    state = replace(state, world_from_prop=Poses(R, t))
    return replace(solved, seen=seen, solution=replace(solved.solution, state=state))
