"""Self-checks of a rig solved from a prop: each states the value, the limit, and the next step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.report import CalibrationReport, Check
from posefuse.calibration.solving.rotations import Poses, angle_between, centre_covariance_m2, mean_rotation
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.coverage import linked_groups
from posefuse.calibration.targets.detection import BLURRED_EDGE_PX
from posefuse.calibration.targets.kinds import Charuco, Target, scale_m
from posefuse.core import SE3, Camera
from posefuse.core.arrays import Array

from .lens_check import LensChange, best_stretch, check_board_shape, check_lenses, lens_change
from .limits import LIMITS
from .own_intrinsics import check_carried
from .pipeline import LEAST_TIME_STEPS, TIME_STEPS, Links, Options, Solved, key_snapshots, link, solve_linked, thinned
from .prop_solve import Freedom, PropSolution, solve_prop
from .snapshots import middle_ns

IN_STEP = "cameras are synchronised"
# two cameras that stand apart never see so many corners within this of each other
_SAME_VIDEO_CORNERS, _SAME_VIDEO_PX = 40, 1.0


def check_target_seen(observations: CornerObservations) -> Check:
    """Every camera saw the target."""
    views = np.bincount(observations.camera[observations.view_starts()], minlength=len(observations.cameras))
    blind = [f"{name} (0 of {n} frames)" for name, n, v in zip(observations.cameras, observations.frame_count, views, strict=True)
             if v == 0]  # fmt: skip
    detail = f"the target was not found by {', '.join(blind)}" if blind else "every camera saw the target"
    return Check("target seen", not blind, detail, "show it there, check focus, light and marker size, or leave the camera out")


def check_target_moves(observations: CornerObservations) -> Check:
    """The target is at more than one place: frames of one pose determine no more than one of them."""
    key = np.stack([observations.camera, observations.patch, observations.corner], axis=1)
    first, place, count = np.unique(key, axis=0, return_index=True, return_inverse=True, return_counts=True)[1:]
    place = place.ravel()
    middle = np.stack([np.bincount(place, xy) for xy in observations.xy_img.T], axis=1) / count[:, None]
    spread_px = np.sqrt(np.bincount(place, ((observations.xy_img - middle[place]) ** 2).sum(axis=1)) / count)
    width_px = np.array([max(wh) for wh in observations.sizes_wh])[observations.camera[first]]
    # a corner in a few images shows no motion, and that there are too few is another check's word
    often = count >= LEAST_TIME_STEPS
    share = float((spread_px / width_px)[often].max(initial=0.0))
    moves = not often.any() or share >= LIMITS.target_spread_share
    still = "" if moves else ": it is held still, and frames of one pose count as one"
    detail = f"corners spread by {share:.1%} of an image's width (needed {LIMITS.target_spread_share:.0%}){still}"
    return Check("target moves", moves, detail, "wave it through the whole volume")


def check_doubled(observations: CornerObservations) -> Check:
    """No marker comes twice in many images."""
    frames = dict(zip(observations.cameras, observations.frame_count, strict=True))
    often = [f"marker {m} in {n} frames of {c}" for c, m, n in observations.doubled if n > 0.05 * frames[c] and n > 5]
    return Check(
        "marker ids are unique", not often, f"met twice in one image: {'; '.join(often)}" if often else "no id comes twice",
        "two props or two faces carry the same id: take one away",
    )  # fmt: skip


def check_same_video_by_corners(observations: CornerObservations) -> Check:
    """No two cameras have the same image points at the same times."""
    key = np.stack([observations.t_ns, observations.patch, observations.corner], axis=1)
    place = np.unique(key, axis=0, return_inverse=True)[1].ravel()
    xy = np.full((len(observations.cameras), int(place.max(initial=-1)) + 1, 2), np.nan)
    xy[observations.camera, place] = observations.xy_img
    alike = []
    for a in range(len(xy)):
        for b in range(a + 1, len(xy)):
            off = np.linalg.norm(xy[a] - xy[b], axis=1)
            off = off[np.isfinite(off)]
            if len(off) >= _SAME_VIDEO_CORNERS and float(np.median(off)) < _SAME_VIDEO_PX:
                alike.append(f"{observations.cameras[a]} and {observations.cameras[b]}")
    return videos_differ(alike)


def videos_differ(alike: Sequence[str]) -> Check:
    """No pair of cameras is in `alike`, in words."""
    detail = f"{', '.join(alike)} show the same video" if alike else "no two cameras show the same"
    return Check("videos differ", not alike, detail, "give each camera its own video", "input")


def check_sharp(observations: CornerObservations) -> Check:
    """What moves has sharp edges in the images of every camera."""
    blurred = [(name, px) for name, px in observations.edge_width_px if px > BLURRED_EDGE_PX]
    names = "all cameras" if len(blurred) == len(observations.cameras) else ", ".join(name for name, _ in blurred)
    widest_px = max((px for _, px in blurred), default=0.0)
    detail = f"the images of {names} are blurred: moving edges are {widest_px:.0f} px wide (limit"
    return Check(
        "images are sharp", not blurred, f"{detail} {BLURRED_EDGE_PX:.0f} px)" if blurred else "moving edges are sharp",
        "shorten the exposure time, add light, move the target more slowly, and check the focus",
    )  # fmt: skip


def check_links(names: Sequence[str], links: Links, views_together: Array) -> Check:
    """All cameras hang together through time steps at which two of them see the prop and agree."""
    linked = np.zeros((len(names), len(names)), bool)
    for i in links.placed:
        for j in links.placed:
            linked[i, j] = True
    groups = linked_groups(linked | np.eye(len(names), dtype=bool))
    if len(groups) == 1:
        weakest = min(int(np.sort(row)[-2]) for row in views_together) if len(names) > 1 else 0
        return Check("cameras are linked", True, f"every camera shares at least {weakest} key time steps with another")
    lost = [names[i] for group in groups[1:] for i in group]
    detail = f"{', '.join(lost)} cannot be linked to {', '.join(names[i] for i in groups[0])}: {_link_story(names, links, lost)}"
    return Check(
        "cameras are linked", False, detail,
        f"hold the prop where {lost[0]} and another camera both see it for a few seconds; if they do, the cameras are out of"
        " step (try clocks = offset) or an intrinsic calibration is wrong",
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


def check_fit(cameras: Sequence[Camera], solved: Solved) -> Check:
    """The corners fit as well as detection can be trusted."""
    limit = LIMITS.corner_spread_px_per_1000 * max(max(camera.size_wh) for camera in cameras) / 1000
    sigma = solved.solution.sigma_px
    return Check("corners fit", sigma <= limit, f"spread of a corner coordinate {sigma:.2f} px (limit {limit:.2f})",
                 "blur, cameras unsynchronised (try clocks = offset), wrong intrinsics, or a prop that bends")  # fmt: skip


def check_still(cameras: Sequence[Camera], solved: Solved) -> Check:
    """No camera agrees for a part of the recording only."""
    first = solved.seen.group_starts()
    camera, inlier = solved.seen.camera[first], solved.inlier
    t_s = solved.seen.t_s[solved.seen.time_step[first]]
    edges = np.linspace(t_s.min(), t_s.max() + 1e-9, LIMITS.segments + 1)
    segment = np.clip(np.searchsorted(edges, t_s, side="right") - 1, 0, LIMITS.segments - 1)
    for c, named in enumerate(cameras):
        count = np.bincount(segment[camera == c], minlength=LIMITS.segments)
        share = np.bincount(segment[camera == c], inlier[camera == c], LIMITS.segments) / np.maximum(count, 1)
        bad = (count >= LIMITS.segment_views) & (share < LIMITS.segment_share)
        if bad.any():
            begin, end = int(np.flatnonzero(bad)[0]), int(np.flatnonzero(bad)[-1]) + 1
            when = f"from {edges[begin] - edges[0]:.0f} s to {edges[end] - edges[0]:.0f} s"
            if (begin, end) == (0, LIMITS.segments):
                when += ", the whole recording"
                remedy = "it was moved several times, is unsynchronised, or the times of its frames are wrong"
            else:
                when += ", and agrees at other times"
                remedy = "it was moved, its image froze, or its clock jumped: calibrate with the part before or after"
            return Check("cameras stand still", False, f"{named.name} disagrees with the others {when}", remedy)
    return Check("cameras stand still", True, "every camera agrees over the whole recording")


def check_determined(cameras: Sequence[Camera], solved: Solved, distance_m: float) -> Check:
    """Standard errors of the camera positions are small."""
    sigma = position_sigma_m(solved)
    worst, limit = int(np.argmax(sigma)), LIMITS.position_sigma_share * distance_m
    return Check(
        "cameras are determined", bool(sigma[worst] <= limit),
        f"standard error of {cameras[worst].name}'s position {sigma[worst] * 1e3:.1f} mm (limit {limit * 1e3:.1f})",
        "let this camera see the prop more often, nearer and together with others",
    )  # fmt: skip


def position_sigma_m(solved: Solved) -> Array:
    """(C,) standard error of each camera's centre against the reference camera."""
    return np.asarray(np.sqrt(np.trace(position_cov_m2(solved), axis1=-2, axis2=-1)))


def position_cov_m2(solved: Solved) -> Array:
    """(C, 3, 3) covariance of each camera's centre against the reference camera, in the frame of the solution."""
    return centre_covariance_m2(solved.solution.state.cam_from_world, solved.solution.camera_covariance)


def camera_differences(first: Poses, second: Poses) -> tuple[Array, Array]:
    """Distance (C,) m and angle (C,) rad between two sets of cam_from_world, after the best common rigid motion."""
    a, b = first.inverse(), second.inverse()
    turn = _common_turn(a, b)
    moved = (b.t - b.t.mean(axis=0)) @ turn.T
    return np.linalg.norm(a.t - a.t.mean(axis=0) - moved, axis=1), angle_between(a.R, turn @ b.R)


def scale_of(first: Poses, second: Poses) -> float:
    """How many times as large as the second set of cam_from_world the first is, by the cameras' centres in least squares."""
    a, b = first.inverse(), second.inverse()
    moved = (b.t - b.t.mean(axis=0)) @ _common_turn(a, b).T
    return float(((a.t - a.t.mean(axis=0)) * moved).sum() / (moved**2).sum())


def _common_turn(a: Poses, b: Poses) -> Array:
    """(3, 3) mean rotation that takes the cameras' axes world_from_cam of b to those of a."""
    return mean_rotation(a.R @ np.swapaxes(b.R, 1, 2), np.ones(len(a)))


def check_facing(cameras: Sequence[Camera], solved: Solved) -> Check:
    """The printed faces look at the cameras that see them: a mirrored board looks away."""
    seen, state = solved.seen, solved.solution.state
    first = seen.group_starts()
    world_from_patch = state.world_from_prop[seen.time_step[first]] @ state.prop_from_patch[seen.patch[first]]
    cam_from_patch = state.cam_from_world[seen.camera[first]] @ world_from_patch
    middle = np.stack([cam_from_patch.move(np.tile(corner, (len(first), 1))) for corner in solved.corners[0]]).mean(axis=0)
    facing = ((cam_from_patch.R[:, :, 2] * middle).sum(axis=1) < 0) & (middle[:, 2] > 0)
    share = {
        camera.name: float(facing[seen.camera[first] == c].mean())
        for c, camera in enumerate(cameras)
        if (seen.camera[first] == c).any()
    }
    worst = min(share, key=lambda name: share[name])
    return Check(
        "nothing is mirrored", share[worst] >= LIMITS.facing_share,
        f"{share[worst]:.0%} of {worst}'s views see the printed face (needed {LIMITS.facing_share:.0%})",
        "the board is described mirrored, the image is flipped, or the markers are too small to show their slant", "input",
    )  # fmt: skip


def check_clocks(cameras: Sequence[Camera], free: PropSolution) -> Check:
    """Clocks that are let free stay: against the median, since the held one may be the one that is off."""
    late_s, sigma_s = free.state.delay_s - np.median(free.state.delay_s, axis=0), free.delay_sigma_s
    least = np.array([LIMITS.late_s, LIMITS.drift])
    off = np.abs(late_s) > np.maximum(least, LIMITS.late_sigma * sigma_s)
    words = [
        f"the clock of {camera.name} runs {drift * 1e6:+.0f} ppm fast (drift)" if drifts else
        f"the clock of {camera.name} is off by {late * 1e3:+.1f} ms"
        for camera, (late, drift), (is_late, drifts) in zip(cameras, late_s, off, strict=True) if is_late or drifts
    ]  # fmt: skip
    worst = int(np.argmax(np.abs(late_s[:, 0])))
    fine = f"{cameras[worst].name} is off most, by {late_s[worst, 0] * 1e3:+.1f} ± {sigma_s[worst, 0] * 1e3:.1f} ms"
    drifting = bool(off[:, 1].any())
    return Check(
        IN_STEP, not words, f"{', '.join(words) or fine} (limit {LIMITS.late_s * 1e3:.0f} ms)",
        f"the cameras are not synchronised: calibrate with `clocks={'drift' if drifting else 'offset'}`",
        "drift" if drifting else "clocks",
    )  # fmt: skip


def check_cameras_apart(cameras: Sequence[Camera], cam_from_world: Poses) -> Check:
    """No two cameras share a body."""
    a, b, distance_m = nearest_two(cam_from_world.inverse().t)
    return Check(
        "cameras are apart", distance_m >= LIMITS.apart_m,
        f"{cameras[a].name} and {cameras[b].name} are nearest, {distance_m * 1e3:.0f} mm (needed {LIMITS.apart_m * 1e3:.0f})",
        "is one stream given twice?",
    )  # fmt: skip


def nearest_two(centres: Array) -> tuple[int, int, float]:
    """Which two of the points (C, 3) are nearest to each other, and their distance."""
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=-1) + np.eye(len(centres)) * 1e9
    a, b = (int(i) for i in np.unravel_index(np.argmin(distance), distance.shape))
    return a, b, float(distance[a, b])


def check_upright(cameras: Sequence[Camera], up_cam: Array) -> Check:
    """No camera is upside down against the world's up (C, 3) in camera axes."""
    cosine = -up_cam[:, 1] / np.maximum(np.linalg.norm(up_cam[:, :2], axis=1), 1e-9)
    # a camera that looks straight up or down has no top
    cosine = np.where(np.linalg.norm(up_cam[:, :2], axis=1) < 0.2, 1.0, cosine)
    wrong = [camera.name for camera, value in zip(cameras, cosine, strict=True) if value < LIMITS.upside_down_cosine]
    return Check(
        "images are upright", not wrong, f"upside down: {', '.join(wrong)}" if wrong else "the top of every image is up",
        "turn the image; for a camera that is mounted upside down, name it with `upside_down=CAMERA`", "upside down",
        tuple(wrong),
    )  # fmt: skip


_HALVES = 2


@dataclass(frozen=True, eq=False)
class Halves:
    """Two solves that share no data.

    Attributes:
        solved: of each half; empty where the data are not enough. story: why.
        together, apart: (2, C) px usual size of each half's residuals in the common solve, and in the half's own.
    """

    solved: tuple[Solved, ...]
    story: str
    together: Array
    apart: Array


def solve_halves(
    observations: CornerObservations, cameras: tuple[Camera, ...], target: Target, options: Options, solved: Solved
) -> Halves:
    """The first and the second half from scratch; where a camera lacks one, every other fifth of them."""
    story = ""
    for stretches in (_HALVES, 5 * _HALVES):
        found: list[Solved] = []
        for half in range(_HALVES):
            part = observations.rows(_half_of(observations.t_ns, observations, stretches) == half)
            one, story = _solve_half(part, cameras, target, options, solved)
            if one is None:
                break
            found.append(one)
        if len(found) == _HALVES:
            steps_ns = np.round(solved.seen.t_s * 1e9).astype(np.int64) + middle_ns(observations)
            half_of = _half_of(steps_ns, observations, stretches)
            together = np.stack([spread_px(solved, half_of == half, len(cameras)) for half in range(_HALVES)])
            apart = np.stack([spread_px(one, np.ones(len(one.seen.t_s), bool), len(cameras)) for one in found])
            return Halves(tuple(found), "", together, apart)
    nothing = np.full((_HALVES, len(cameras)), np.nan)
    return Halves((), story, nothing, nothing)


def check_one_place(cameras: Sequence[Camera], halves: Halves) -> Check:
    """One rig fits both halves as well as each fits its own, or the difference is none of the poses.

    Larger residuals alone refuse nothing: uneven time stamps, or a lens model that fits one region better, also cause them.
    A camera that was moved has poses that differ, too.
    """
    if not halves.solved:
        return Check(
            "one place per camera", False, f"half of the data is not enough to solve: {halves.story}",
            "wave the target longer, so that every camera sees it in both halves",
        )  # fmt: skip
    ratio = np.nan_to_num(halves.together / np.maximum(halves.apart, 1e-6), nan=1.0).max(axis=0)
    first, second = (one.solution for one in halves.solved)
    apart_m, turned_rad = camera_differences(first.state.cam_from_world, second.state.cam_from_world)
    sigma_m = np.hypot(*(position_sigma_m(one) for one in halves.solved))
    sigma_rad = np.sqrt(sum(np.trace(one.camera_covariance[:, :3, :3], axis1=1, axis2=2) for one in (first, second)))
    sigma_m, sigma_rad = _shared(sigma_m), _shared(sigma_rad)
    sigmas = np.maximum(apart_m / np.maximum(sigma_m, 1e-12), turned_rad / np.maximum(sigma_rad, 1e-12))
    wrong = (ratio > LIMITS.spread_ratio) & (sigmas > LIMITS.moved_sigma)
    c = int(np.argmax(np.where(wrong, 1e3, 1.0) * ratio))
    return Check(
        "one place per camera", not wrong.any(),
        f"{cameras[c].name}'s corners spread {ratio[c]:.2f} times as far in one rig for the whole recording as in one for each"
        f" half (limit {LIMITS.spread_ratio:.2f} where poses differ, too), and its pose differs between the halves by"
        f" {apart_m[c] * 1e3:.1f} ± {sigma_m[c] * 1e3:.1f} mm and"
        f" {np.rad2deg(turned_rad[c]):.2f} ± {np.rad2deg(sigma_rad[c]):.2f} deg",
        "it was moved or refocused during the recording: calibrate again, or use the part before or after",
    )  # fmt: skip


def check_turning(cameras: Sequence[Camera], free: PropSolution, solved: Solved) -> Check:
    """No camera turns all the time: its rate, when it is let free with the intrinsics, is none.

    The halves show that badly: each scatters by half of the turn, and their standard errors grow with it.
    """
    c, angle_rad, sigmas = most_turned(free, solved)
    wrong = angle_rad > LIMITS.turned_rad and sigmas > LIMITS.lens_sigma
    words = f"{cameras[c].name} was moved slowly: it turned by" if wrong else f"{cameras[c].name} turns most, by"
    return Check(
        "no camera turns", not wrong,
        f"{words} {np.rad2deg(angle_rad):.2f} deg over the recording, {sigmas:.1f} standard errors (limits"
        f" {np.rad2deg(LIMITS.turned_rad):.2f} deg and {LIMITS.lens_sigma:.0f})",
        "fasten it, and calibrate again",
    )  # fmt: skip


def most_turned(free: PropSolution, solved: Solved) -> tuple[int, float, float]:
    """The camera whose turn is farthest over its limits, by how many rad it turns over the recording, and how many standard
    errors its own turn is.

    Against the median: cameras in a row hardly determine a turn that all share about that row, and it moves none against another.
    """
    rate = free.state.turn_rad_s
    world = np.einsum("cji,cj->ci", free.state.cam_from_world.R, rate)
    square = (rate * np.linalg.solve(free.turn_covariance, rate[..., None])[..., 0]).sum(axis=1)
    angle_rad = np.linalg.norm(world - np.median(world, axis=0), axis=1) * np.ptp(solved.seen.t_s)
    sigmas = np.sqrt(np.maximum(square, 0.0))
    c = int(np.argmax(np.minimum(angle_rad / LIMITS.turned_rad, sigmas / LIMITS.lens_sigma)))
    return c, float(angle_rad[c]), float(sigmas[c])


def _shared(sigma: Array) -> Array:
    """Standard errors (C,) with the reference camera's, which is held at 0, as that of a usual camera."""
    return np.maximum(sigma, float(np.median(sigma[sigma > 0])) if (sigma > 0).any() else 0.0)


def spread_px(solved: Solved, steps: Array, cameras: int) -> Array:
    """(C,) median size of a corner's residual at some of the time steps; NaN where there are none."""
    size = np.linalg.norm(solved.solution.residual_px, axis=1)
    rows = steps[solved.seen.time_step] & np.isfinite(size)
    mine = [rows & (solved.seen.camera == c) for c in range(cameras)]
    return np.array([np.median(size[m]) if m.any() else np.nan for m in mine])


def _half_of(t_ns: Array, observations: CornerObservations, count: int) -> Array:
    """0 or 1 by turns along `count` stretches of the recording."""
    first, last = int(observations.t_ns.min()), int(observations.t_ns.max()) + 1
    return np.asarray((t_ns - first) * count // (last - first) % _HALVES)


def _solve_half(
    part: CornerObservations, cameras: tuple[Camera, ...], target: Target, options: Options, solved: Solved
) -> tuple[Solved | None, str]:
    delay_s = solved.solution.state.delay_s
    together = replace(options, clocks="together", time_steps=max(options.time_steps // 2, min(options.time_steps, TIME_STEPS)))
    if set(np.unique(part.camera)) != set(range(len(cameras))):
        return None, "a camera sees nothing in it"
    seen = key_snapshots(part, together, delay_s)
    if len(seen.camera) == 0:
        return None, "no shared views"
    links = link(cameras, target, seen)
    if len(links.placed) < len(cameras):
        lost = [camera.name for i, camera in enumerate(cameras) if i not in links.placed]
        return None, f"{', '.join(lost)} not linked"
    return solve_linked(part, cameras, target, together, links, delay_s), ""


_MM = 1000.0
UNITS = "sizes are millimetres on the command line, metres in Python"


def _edge(target: Target) -> str:
    return "square" if isinstance(target, Charuco) else "marker side"


def check_target_size(target: Target) -> Check:
    """A marker or square can be printed and carried."""
    side_m, (least_m, most_m) = scale_m(target), LIMITS.target_side_m
    return Check(
        "target has a plausible size", least_m <= side_m <= most_m,
        f"{_edge(target)} {side_m * _MM:g} mm (expected {least_m * _MM:g} to {most_m * _MM:g} mm)",
        f"check the unit: {UNITS}", "input",
    )  # fmt: skip


def check_rig_size(target: Target, cameras: tuple[Camera, ...], cam_from_world: SE3, distance_m: float, any_size: bool) -> Check:
    """Target and cameras are as far from each other as in a room in which a person moves."""
    a, b, apart_m = nearest_two(cam_from_world.inverse().xyz)
    least_m, most_m = LIMITS.distance_m
    return Check(
        "rig has a plausible size", any_size or least_m <= distance_m <= most_m,
        f"with a {_edge(target)} of {scale_m(target) * _MM:g} mm the target was {distance_m:.2f} m from the cameras, and"
        f" {cameras[a].name} and {cameras[b].name} are {apart_m:.2f} m apart"
        f" (expected a distance of {least_m:g} to {most_m:g} m)",
        f"measure the print: {UNITS}; for a rig that really has this size add `any_size=True`", "input",
    )  # fmt: skip


_FREE_FOCAL, _FREE_LENS = 0.2, (10.0, 10.0, 0.05, 0.05)


def solution_checks(
    observations: CornerObservations,
    cameras: tuple[Camera, ...],
    target: Target,
    options: Options,
    solved: Solved,
    before: list[Check],
) -> list[Check]:
    """All checks of a solution; raises RefusedCalibration after the quick ones, since the others take further solves."""
    state, distance_m = solved.solution.state, usual_distance_m(solved)
    determined = check_determined(cameras, solved, distance_m)
    quick = [
        check_still(cameras, solved),
        check_facing(cameras, solved),
        check_fit(cameras, solved),
        determined,
        check_cameras_apart(cameras, state.cam_from_world),
        check_rig_size(target, cameras, state.cam_from_world.se3(), distance_m, options.any_size),
    ]
    if options.own_intrinsics:
        quick.insert(0, check_carried(cameras, observations, solved))
    if options.clocks == "together" and [check for check in quick if not check.passed] == [determined]:
        # a camera that is late spreads the corners, and the poses with them
        quick.append(check_clocks(cameras, let_clocks_free(cameras, solved)))
    CalibrationReport("extrinsics", (*before, *quick)).require()
    halves = solve_halves(observations, cameras, target, options, solved)
    done = [
        *quick,
        check_one_place(cameras, halves),
        check_turning(cameras, let_cameras_turn(cameras, solved, options.clocks != "together"), solved),
        check_lenses(cameras, _lens_change(cameras, solved, halves, options)),
    ]
    if isinstance(target, Charuco):
        done.append(check_board_shape(best_stretch(thinned(solved), cameras)))
    if options.clocks == "together":
        done.append(check_clocks(cameras, let_clocks_free(cameras, solved)))
    return done


def let_clocks_free(cameras: tuple[Camera, ...], solved: Solved) -> PropSolution:
    """The solve again with a clock of its own for every camera."""
    freedom = Freedom(reference=solved.links.reference, held_patches=solved.links.shape.held, offset=True)
    return solve_prop(solved.seen, solved.corners, cameras, solved.solution.state, freedom)


def _lens_change(cameras: tuple[Camera, ...], solved: Solved, halves: Halves, options: Options) -> LensChange:
    parts = [_change_of(cameras, half, False) for half in halves.solved]
    return _change_of(cameras, solved, options.clocks != "together").confirmed_by(parts)


def _change_of(cameras: tuple[Camera, ...], solved: Solved, offset: bool) -> LensChange:
    free = let_lenses_free(cameras, solved, offset)
    return lens_change(cameras, solved.solution, free, solved.seen)


def let_cameras_turn(cameras: tuple[Camera, ...], solved: Solved, offset: bool) -> PropSolution:
    """The solve again with nearly free intrinsics, which a turn must not stand for, and with cameras that may turn."""
    return let_lenses_free(cameras, solved, offset, turning=tuple(range(len(cameras))))


def let_lenses_free(
    cameras: tuple[Camera, ...],
    solved: Solved,
    offset: bool,
    of: tuple[int, ...] | None = None,
    turning: tuple[int, ...] = (),
) -> PropSolution:
    """The solve again with nearly free intrinsics, of all cameras or of some."""
    focal_px = _FREE_FOCAL * float(focal_lengths_px(cameras).mean())
    sigma = np.array([focal_px, focal_px, *_FREE_LENS])
    freedom = Freedom(
        reference=solved.links.reference,
        held_patches=solved.links.shape.held,
        offset=offset,
        drift=False,
        lens_sigma=sigma,
        lens_of=of,
        turning=turning,
    )
    return solve_prop(solved.seen, solved.corners, cameras, solved.solution.state, freedom)


def focal_lengths_px(cameras: tuple[Camera, ...]) -> Array:
    """(C,) fx."""
    return np.array([camera.K[0, 0] for camera in cameras])


def usual_distance_m(solved: Solved) -> float:
    """Median distance of the target from the cameras."""
    seen, state = solved.seen, solved.solution.state
    in_cam = state.cam_from_world[seen.camera].move(state.world_from_prop.t[seen.time_step])
    return float(np.median(np.linalg.norm(in_cam, axis=1)))
