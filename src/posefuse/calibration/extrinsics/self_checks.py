"""Self-checks of a rig solved from a prop: each states the value, the limit, and the next step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posefuse.calibration.report import Check
from posefuse.calibration.solving.rotations import Poses, angle_between, mean_rotation
from posefuse.calibration.targets.blur import BLURRED_EDGE_PX
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.coverage import linked_groups
from posefuse.core import Camera
from posefuse.core.arrays import Array

from .limits import LIMITS, Limits
from .pipeline import LEAST_TIME_STEPS, Links, Solved

IN_STEP = "cameras are synchronised"
CORNERS_FIT = "corners fit"
# two cameras that stand apart never see so many corners within this of each other
_SAME_VIDEO_CORNERS, _SAME_VIDEO_PX = 40, 1.0


def check_target_seen(observations: CornerObservations) -> Check:
    """Every camera saw the target."""
    views = np.bincount(observations.camera[observations.view_starts()], minlength=len(observations.cameras))
    blind = [f"{name} (0 of {n} frames)" for name, n, v in zip(observations.cameras, observations.frame_count, views, strict=True)
             if v == 0]  # fmt: skip
    detail = f"the target was not found by {', '.join(blind)}" if blind else "every camera saw the target"
    return Check("target seen", not blind, detail, "show it there, check focus, light and marker size, or leave the camera out")


def check_target_moves(observations: CornerObservations, limits: Limits = LIMITS) -> Check:
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
    moves = not often.any() or share >= limits.target_spread_share
    still = "" if moves else ": it is held still, and frames of one pose count as one"
    detail = f"corners spread by {share:.1%} of an image's width (needed {limits.target_spread_share:.0%}){still}"
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


def check_fit(cameras: Sequence[Camera], solved: Solved, limits: Limits = LIMITS) -> Check:
    """The corners fit as well as detection can be trusted."""
    limit = limits.corner_spread_px_per_1000 * max(max(camera.size_wh) for camera in cameras) / 1000
    sigma = solved.solution.sigma_px
    return Check(CORNERS_FIT, sigma <= limit, f"spread of a corner coordinate {sigma:.2f} px (limit {limit:.2f})",
                 "blur, cameras unsynchronised (try clocks = offset), wrong intrinsics, or a prop that bends")  # fmt: skip


def check_cameras_agree(cameras: Sequence[Camera], solved: Solved, limits: Limits = LIMITS) -> Check:
    """Every camera's views agree with the common solution."""
    first = solved.seen.group_starts()
    camera, inlier = solved.seen.camera[first], solved.inlier
    count = np.bincount(camera, minlength=len(cameras))
    share = np.bincount(camera, inlier, len(cameras)) / np.maximum(count, 1)
    worst = int(np.argmin(share))
    return Check(
        "cameras agree", bool(share[worst] >= limits.inlier_share),
        f"{cameras[worst].name} agrees worst: {share[worst]:.0%} of its {count[worst]} marker views"
        f" (needed {limits.inlier_share:.0%})",
        "it moved, is unsynchronised, has wrong intrinsics (a turned or cropped image?), or sees a second prop",
    )  # fmt: skip


def check_still(cameras: Sequence[Camera], solved: Solved, limits: Limits = LIMITS) -> Check:
    """No camera agrees for a part of the recording only."""
    first = solved.seen.group_starts()
    camera, inlier = solved.seen.camera[first], solved.inlier
    t_s = solved.seen.t_s[solved.seen.time_step[first]]
    edges = np.linspace(t_s.min(), t_s.max() + 1e-9, limits.segments + 1)
    segment = np.clip(np.searchsorted(edges, t_s, side="right") - 1, 0, limits.segments - 1)
    for c, named in enumerate(cameras):
        count = np.bincount(segment[camera == c], minlength=limits.segments)
        share = np.bincount(segment[camera == c], inlier[camera == c], limits.segments) / np.maximum(count, 1)
        bad = (count >= limits.segment_views) & (share < limits.segment_share)
        if bad.any():
            begin, end = int(np.flatnonzero(bad)[0]), int(np.flatnonzero(bad)[-1]) + 1
            when = f"from {edges[begin] - edges[0]:.0f} s to {edges[end] - edges[0]:.0f} s"
            if (begin, end) == (0, limits.segments):
                when += ", the whole recording"
                remedy = "it was moved several times, is unsynchronised, or the times of its frames are wrong"
            else:
                when += ", and agrees at other times"
                remedy = "it was moved, its image froze, or its clock jumped: calibrate with the part before or after"
            return Check("cameras stand still", False, f"{named.name} disagrees with the others {when}", remedy)
    return Check("cameras stand still", True, "every camera agrees over the whole recording")


def check_determined(cameras: Sequence[Camera], solved: Solved, distance_m: float, limits: Limits = LIMITS) -> Check:
    """Standard errors of the camera positions are small."""
    sigma = position_sigma_m(solved)
    worst, limit = int(np.argmax(sigma)), limits.position_sigma_share * distance_m
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
    covariance = solved.solution.camera_covariance
    R, t = solved.solution.state.cam_from_world.R, solved.solution.state.cam_from_world.t
    # centre = -R^T t; a left turn w moves R, not t: d centre = -R^T (dt + [t]x w)
    out = np.zeros((len(R), 3, 3))
    for c in range(len(R)):
        cross = np.array([[0, -t[c, 2], t[c, 1]], [t[c, 2], 0, -t[c, 0]], [-t[c, 1], t[c, 0], 0]])
        slope = -R[c].T @ np.hstack([cross, np.eye(3)])
        out[c] = slope @ covariance[c] @ slope.T
    return out


def check_halves(
    cameras: Sequence[Camera], halves: tuple[Poses, Poses], sigma_m: Array, distance_m: float, limits: Limits = LIMITS
) -> Check:
    """Two solves that share no data put the cameras at the same places."""
    apart_m, turned_rad = camera_differences(*halves)
    limit_m = float(
        np.clip(limits.halves_sigma * sigma_m.max(), limits.halves_share * distance_m, limits.halves_most_share * distance_m)
    )
    worst = int(np.argmax(np.maximum(apart_m / limit_m, turned_rad / limits.halves_rad)))
    passed = bool((apart_m <= limit_m).all() and (turned_rad <= limits.halves_rad).all())
    return Check(
        "halves agree", passed,
        f"from separate data {cameras[worst].name} differs by {apart_m[worst] * 1e3:.1f} mm and"
        f" {np.rad2deg(turned_rad[worst]):.2f} deg (limits {limit_m * 1e3:.1f} mm,"
        f" {np.rad2deg(limits.halves_rad):.1f} deg)",
        "it was moved or refocused between the halves, or the data are too few: wave longer, over the whole volume",
    )  # fmt: skip


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


def check_facing(cameras: Sequence[Camera], solved: Solved, limits: Limits = LIMITS) -> Check:
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
        "nothing is mirrored", share[worst] >= limits.facing_share,
        f"{share[worst]:.0%} of {worst}'s views see the printed face (needed {limits.facing_share:.0%})",
        "the board is described mirrored, the image is flipped, or the markers are too small to show their slant", "input",
    )  # fmt: skip


def check_clocks(cameras: Sequence[Camera], late_s: Array, sigma_s: Array, limits: Limits = LIMITS) -> Check:
    """Synchronised cameras show no offset when they are allowed one."""
    ratio = np.abs(late_s) / np.maximum(limits.late_s, limits.late_sigma * sigma_s)
    worst = int(np.argmax(ratio))
    return Check(
        IN_STEP, bool(ratio[worst] <= 1),
        f"{cameras[worst].name} runs {late_s[worst] * 1e3:+.1f} ms late (standard error {sigma_s[worst] * 1e3:.1f} ms,"
        f" limit {limits.late_s * 1e3:.0f} ms)",
        "the cameras are not synchronised: calibrate with clocks = offset", "clocks",
    )  # fmt: skip


def check_cameras_apart(cameras: Sequence[Camera], cam_from_world: Poses, limits: Limits = LIMITS) -> Check:
    """No two cameras share a body."""
    a, b, distance_m = nearest_two(cam_from_world.inverse().t)
    return Check(
        "cameras are apart", distance_m >= limits.apart_m,
        f"{cameras[a].name} and {cameras[b].name} are nearest, {distance_m * 1e3:.0f} mm (needed {limits.apart_m * 1e3:.0f})",
        "is one stream given twice?",
    )  # fmt: skip


def nearest_two(centres: Array) -> tuple[int, int, float]:
    """Which two of the points (C, 3) are nearest to each other, and their distance."""
    distance = np.linalg.norm(centres[:, None] - centres[None], axis=-1) + np.eye(len(centres)) * 1e9
    a, b = (int(i) for i in np.unravel_index(np.argmin(distance), distance.shape))
    return a, b, float(distance[a, b])


def check_upright(cameras: Sequence[Camera], up_cam: Array, limits: Limits = LIMITS) -> Check:
    """No camera is upside down against the world's up (C, 3) in camera axes."""
    cosine = -up_cam[:, 1] / np.maximum(np.linalg.norm(up_cam[:, :2], axis=1), 1e-9)
    # a camera that looks straight up or down has no top
    cosine = np.where(np.linalg.norm(up_cam[:, :2], axis=1) < 0.2, 1.0, cosine)
    wrong = [camera.name for camera, value in zip(cameras, cosine, strict=True) if value < limits.upside_down_cosine]
    return Check(
        "images are upright", not wrong, f"upside down: {', '.join(wrong)}" if wrong else "the top of every image is up",
        "turn the image; for a camera that is mounted upside down, name it with `upside_down=CAMERA`", "upside down",
        tuple(wrong),
    )  # fmt: skip
