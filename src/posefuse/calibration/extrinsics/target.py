"""Where the cameras are, from a moving prop or board: solve, check, set the world, or refuse by name."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration
from posefuse.calibration.solving.projection import Lenses
from posefuse.calibration.solving.rotations import Poses
from posefuse.calibration.targets.corners import Observations
from posefuse.calibration.targets.coverage import Coverage, coverage
from posefuse.calibration.targets.kinds import Chessboard, Target
from posefuse.core import SE3, CalibrationError, Camera, Rig
from posefuse.core.arrays import Array

from . import self_checks as checks
from .clocks import rough_offsets
from .locate import aligned
from .pipeline import Options, Solved, key_snapshots, link, solve_linked, starting_clocks
from .prop_solve import Freedom, PropSolution, solve_prop
from .self_checks import CORNERS_FIT, IN_STEP
from .snapshots import middle_ns
from .world import UpFromCameras, WorldRule

_HALF_BLOCKS = 2
_OUT_OF_STEP_S = 0.02
_FREE_FOCAL, _FREE_LENS = 0.2, (10.0, 10.0, 0.05, 0.05)
# noise stays when the lenses are let go, the wrong lens goes
_WRONG_LENS_RATIO = 0.6
OUT_OF_STEP = "the paths of the prop fit best with clocks out of step"


@dataclass(frozen=True, eq=False)
class Calibration:
    """A rig that passed its checks, and what it came from.

    Attributes:
        rig: in the world asked for. report: the checks. coverage: of the recording.
        position_sigma_m: (C,) standard error of each camera's place against the reference camera.
        delay_s, delay_sigma_s: (C, 2) clocks (offset s, drift s/s) and their standard errors: a frame that camera c
            stamped s was taken at s - offset - drift * (s - middle).
        middle_ns: middle of the recording, from which drift counts.
        t_ns: (T,) key instants. world_from_prop: (T,) the prop there. prop_from_patch: per marker id.
        camera, xy_img, residual_px: (N,), (N, 2), (N, 2) corners used and predicted minus observed.
    """

    rig: Rig
    report: CalibrationReport
    coverage: Coverage
    position_sigma_m: Array
    delay_s: Array
    delay_sigma_s: Array
    middle_ns: int
    t_ns: Array
    world_from_prop: SE3
    prop_from_patch: dict[int, SE3]
    camera: Array
    xy_img: Array
    residual_px: Array


def calibrate_extrinsics(
    observations: Observations,
    cameras: tuple[Camera, ...],
    target: Target,
    options: Options | None = None,
    world: WorldRule | None = None,
    upside_down: tuple[str, ...] = (),
) -> Calibration:
    """Camera poses from a moving target.

    Args:
        observations: of all cameras; those without a view of the target make it fail by name.
        cameras: intrinsics (their poses are not used), any order.
        target: loose markers on a rigid prop, a ChArUco board or an ArUco board.
        options: how to solve. world: how the world frame is set; without one, up is guessed from the cameras.
        upside_down: cameras that really hang upside down.

    Raises:
        CalibrationError: input that cannot be used. RefusedCalibration (one of them, with the report): a check fails.
    """
    options = options or Options()
    intrinsics = Rig(tuple(replace(camera, cam_from_world=SE3.identity()) for camera in cameras))
    _check_input(observations, intrinsics, target)
    observations = aligned(observations, intrinsics)
    rule = world or UpFromCameras()
    if options.clocks != "auto":
        return _calibrate(observations, intrinsics, target, options, rule, upside_down)
    try:
        return _calibrate(observations, intrinsics, target, replace(options, clocks="together"), rule, upside_down)
    except RefusedCalibration as refused:
        if not any(check.name == IN_STEP or OUT_OF_STEP in check.remedy for check in refused.report.failed):
            raise
        first = refused
    try:
        found = _calibrate(observations, intrinsics, target, replace(options, clocks="offset"), rule, upside_down)
    except CalibrationError:
        raise first from None
    note = "the cameras are not synchronised: their clock offsets were estimated and must be applied when they are used"
    return replace(found, report=replace(found.report, notes=(*found.report.notes, note)))


def _calibrate(
    observations: Observations, intrinsics: Rig, target: Target, options: Options, rule: WorldRule, upside_down: tuple[str, ...]
) -> Calibration:
    done = [checks.check_seen(observations), checks.check_doubled(observations)]
    _stop_if_failed(done)
    solved = _solve(observations, intrinsics.cameras, target, options, done)
    distance_m = _usual_distance_m(solved)
    done += _solution_checks(observations, intrinsics.cameras, target, options, solved, distance_m, done)
    rig = _rig(intrinsics.cameras, solved)
    new_from_old = rule.new_from_old(rig)
    rig = replace(rig.moved(new_from_old), world_set_by=rule.words)
    done += world_checks(rig, rule.has_floor, upside_down)
    report = CalibrationReport("extrinsics", tuple(done), _notes(solved), _numbers(solved, rig, distance_m))
    report.require()
    return _calibration(observations, rig, report, solved, new_from_old)


def _check_input(observations: Observations, intrinsics: Rig, target: Target) -> None:
    if isinstance(target, Chessboard):
        raise CalibrationError("extrinsics: a plain chessboard looks the same from both ends; use a ChArUco board or markers")
    if len(intrinsics) < 2:
        raise CalibrationError(f"extrinsics: expected at least 2 cameras, got {len(intrinsics)}")
    without = [name for name in intrinsics.names if name not in observations.cameras]
    if without:
        raise CalibrationError(
            f"extrinsics: no observations of camera {', '.join(without)}; there are: {', '.join(observations.cameras)}"
        )


def _stop_if_failed(done: list[Check]) -> None:
    CalibrationReport("extrinsics", tuple(done)).require()


def _solve(
    observations: Observations, cameras: tuple[Camera, ...], target: Target, options: Options, done: list[Check]
) -> Solved:
    delay_s = starting_clocks(observations, cameras, target, options)
    seen = key_snapshots(observations, options, delay_s)
    if len(seen.camera) == 0:
        alone = Check("cameras are linked", False, "no two cameras ever see the target at the same time",
                      "hold it where two cameras see it; are the recordings on one clock?")  # fmt: skip
        raise RefusedCalibration(CalibrationReport("extrinsics", (*done, alone)))
    links, in_images = link(observations, cameras, target, seen)
    present = np.zeros((len(seen.t_s), len(cameras)), np.int64)
    present[seen.instant, seen.camera] = 1
    linked = checks.check_links(observations.cameras, links, present.T @ present)
    done.append(_with_clock_hint(linked, observations, cameras, target, options))
    _stop_if_failed(done)
    solved = solve_linked(observations, cameras, target, options, seen, links, in_images, delay_s)
    enough = checks.check_amount(solved)
    done.append(enough)
    _stop_if_failed(done)
    return solved


def _with_clock_hint(
    check: Check, observations: Observations, cameras: tuple[Camera, ...], target: Target, options: Options
) -> Check:
    """A failed check of cameras taken as synchronised, with the offset that may explain it before its own remedy."""
    if check.passed or options.clocks != "together":
        return check
    late = rough_offsets(observations, cameras, target, options.most_offset_s)
    late = late - np.nanmedian(late) if np.isfinite(late).any() else late
    far = [f"{camera.name} {value * 1e3:+.0f} ms" for camera, value in zip(cameras, late, strict=True)
           if abs(value) > _OUT_OF_STEP_S]  # fmt: skip
    if not far:
        return check
    return replace(check, remedy=f"{OUT_OF_STEP} ({', '.join(far)}): use clocks = offset; or else: {check.remedy}")


def _with_lens_hint(check: Check, cameras: tuple[Camera, ...], solved: Solved, options: Options) -> Check:
    """A failed fit of the corners, with the lenses named as the reason where letting them go makes them fit far better."""
    if check.passed:
        return check
    free = _let_lenses_go(cameras, solved, options)
    if free.sigma_px > _WRONG_LENS_RATIO * solved.solution.sigma_px:
        return check
    focal = _focal_px(cameras)
    change, sigma = free.state.lens_delta[:, 0] / focal, free.lens_sigma[:, 0] / focal
    worst = int(np.argmax(np.abs(change)))
    return replace(
        check,
        remedy=f"the lenses given are not those of these cameras: let go, they bring it to {free.sigma_px:.2f} px, and"
        f" {cameras[worst].name}'s focal length moves by {change[worst]:+.0%} (known from these views to {sigma[worst]:.1%}"
        f" only); calibrate each lens with a board of its own (intrinsics); or else: {check.remedy}",
    )


def _solution_checks(
    observations: Observations,
    cameras: tuple[Camera, ...],
    target: Target,
    options: Options,
    solved: Solved,
    distance_m: float,
    before: list[Check],
) -> list[Check]:
    state = solved.solution.state
    quick = [
        checks.check_still(cameras, solved),
        checks.check_facing(cameras, solved),
        checks.check_fit(cameras, solved),
        checks.check_cameras_agree(cameras, solved),
        checks.check_determined(cameras, solved, distance_m),
        checks.check_apart(cameras, state.cam_from_world),
    ]
    quick = [_with_lens_hint(check, cameras, solved, options) if check.name == CORNERS_FIT else check for check in quick]
    wrong = next((i for i, check in enumerate(quick) if not check.passed), None)
    if wrong is not None:
        quick[wrong] = _with_clock_hint(quick[wrong], observations, cameras, target, options)
    # the rest takes further solves, which say nothing about a rig that already fails
    _stop_if_failed([*before, *quick])
    done = [
        *quick,
        *_halves(observations, cameras, target, options, solved, distance_m),
        _lenses(cameras, solved, options),
    ]
    if options.clocks == "together":
        freedom = Freedom(solved.links.reference, solved.links.shape.root, offset=True)
        free = solve_prop(solved.seen, solved.corners, cameras, state, freedom)
        done.append(checks.check_clocks(cameras, free.state.delay_s[:, 0], free.delay_sigma_s[:, 0]))
    return done


def _halves(
    observations: Observations, cameras: tuple[Camera, ...], target: Target, options: Options, solved: Solved, distance_m: float
) -> list[Check]:
    """Solve the first and the second half of the recording from scratch; where a camera lacks one, every other stretch."""
    sigma_m = checks.position_sigma_m(solved)
    story = ""
    for stretches in (_HALF_BLOCKS, 5 * _HALF_BLOCKS):
        found: list[Solved] = []
        for half in (0, 1):
            part = _stretches(observations, stretches, half)
            one, story = _half(part, cameras, target, options, solved)
            if one is None:
                break
            found.append(one)
        if len(found) == _HALF_BLOCKS:
            poses = (found[0].solution.state.cam_from_world, found[1].solution.state.cam_from_world)
            own = np.stack([_spread_px(one, np.ones(len(one.seen.t_s), bool), len(cameras)) for one in found])
            half_of = _stretch_of(
                np.round(solved.seen.t_s * 1e9).astype(np.int64) + middle_ns(observations), observations, stretches
            )
            common = np.stack([_spread_px(solved, half_of == half, len(cameras)) for half in (0, 1)])
            return [
                checks.check_halves(cameras, poses, sigma_m, distance_m),
                checks.check_one_place(cameras, common, own),
            ]
    return [
        Check("halves agree", False, f"half of the data is not enough to solve: {story}",
              "wave the prop longer, so that every camera sees it in both halves")
    ]  # fmt: skip


def _spread_px(solved: Solved, instants: Array, cameras: int) -> Array:
    """(C,) median size of a corner's residual at some of the instants; NaN where there are none."""
    size = np.linalg.norm(solved.solution.residual_px, axis=1)
    rows = instants[solved.seen.instant] & np.isfinite(size)
    mine = [rows & (solved.seen.camera == c) for c in range(cameras)]
    return np.array([np.median(size[m]) if m.any() else np.nan for m in mine])


def _lenses(cameras: tuple[Camera, ...], solved: Solved, options: Options) -> Check:
    """Let the lenses go and see whether the focal lengths stay."""
    focal, free = _focal_px(cameras), _let_lenses_go(cameras, solved, options)
    return checks.check_lenses(cameras, free.state.lens_delta[:, 0] / focal, free.lens_sigma[:, 0] / focal)


def _let_lenses_go(cameras: tuple[Camera, ...], solved: Solved, options: Options) -> PropSolution:
    """The solve once more, with lenses that are hardly held."""
    focal_px = _FREE_FOCAL * float(_focal_px(cameras).mean())
    sigma = np.array([focal_px, focal_px, *_FREE_LENS])
    freedom = Freedom(solved.links.reference, solved.links.shape.root, options.clocks != "together", False, sigma)
    return solve_prop(solved.seen, solved.corners, cameras, solved.solution.state, freedom)


def _focal_px(cameras: tuple[Camera, ...]) -> Array:
    return np.array([camera.K[0, 0] for camera in cameras])


def _stretches(observations: Observations, count: int, half: int) -> Observations:
    """Every second of `count` equal stretches of time, beginning with number `half`."""
    return observations.rows(_stretch_of(observations.t_ns, observations, count) == half)


def _stretch_of(t_ns: Array, observations: Observations, count: int) -> Array:
    """0 or 1 by turns along the recording."""
    first, last = int(observations.t_ns.min()), int(observations.t_ns.max()) + 1
    return np.asarray((t_ns - first) * count // (last - first) % 2)


def _half(
    part: Observations, cameras: tuple[Camera, ...], target: Target, options: Options, solved: Solved
) -> tuple[Solved | None, str]:
    delay_s = solved.solution.state.delay_s
    together = replace(options, clocks="together", instants=max(options.instants // 2, 8))
    if set(np.unique(part.camera)) != set(range(len(cameras))):
        return None, "a camera sees nothing in it"
    seen = key_snapshots(part, together, delay_s)
    if len(seen.camera) == 0:
        return None, "no shared views"
    links, in_images = link(part, cameras, target, seen)
    if len(links.placed) < len(cameras):
        lost = [camera.name for i, camera in enumerate(cameras) if i not in links.placed]
        return None, f"{', '.join(lost)} not linked"
    return solve_linked(part, cameras, target, together, seen, links, in_images, delay_s), ""


def _usual_distance_m(solved: Solved) -> float:
    """Median distance of the corners from the cameras."""
    seen, state = solved.seen, solved.solution.state
    in_cam = state.cam_from_world[seen.camera].move(state.world_from_prop.t[seen.instant])
    return float(np.median(np.linalg.norm(in_cam, axis=1)))


def _rig(cameras: tuple[Camera, ...], solved: Solved) -> Rig:
    state = solved.solution.state
    lenses = Lenses(cameras, state.lens_delta)
    pose = state.cam_from_world.se3()
    placed = tuple(
        replace(camera, K=lenses.camera_matrix(i), distortion=lenses.distortion(i), cam_from_world=pose[i])
        for i, camera in enumerate(cameras)
    )
    good = solved.inlier[solved.seen.group]
    rms = float(np.sqrt((solved.solution.residual_px[good] ** 2).sum(axis=1).mean()))
    return Rig(placed, residual_px=rms)


def world_checks(rig: Rig, has_floor: bool, upside_down: tuple[str, ...] = ()) -> list[Check]:
    """Checks that need the world: cameras above the floor, images upright."""
    up_cam = np.stack([camera.cam_from_world.matrix()[:, 2] for camera in rig])
    up_cam = np.where(np.isin(rig.names, upside_down)[:, None], -up_cam, up_cam)
    done = [checks.check_upright(rig.cameras, up_cam)]
    if has_floor:
        height = rig.centres_world()[:, 2]
        worst = int(np.argmin(height))
        done.append(
            Check("cameras are above the floor", bool(height[worst] > 0),
                  f"the lowest is {rig.names[worst]} at {height[worst]:.2f} m",
                  "the tile lies face down, is described mirrored, or is not on the floor"),
        )  # fmt: skip
    return done


def _notes(solved: Solved) -> tuple[str, ...]:
    notes = [f"marker {patch} left out: {reason}" for patch, reason in sorted(solved.dropped.items())]
    share = float(solved.inlier.mean())
    if share < 1:
        notes.append(f"{1 - share:.1%} of the marker views disagree and count little")
    return tuple(notes)


def _numbers(solved: Solved, rig: Rig, distance_m: float) -> dict[str, float]:
    sigma = checks.position_sigma_m(solved)
    numbers = {
        "residual_px": rig.residual_px,
        "sigma_px": solved.solution.sigma_px,
        "instants": float(len(np.unique(solved.seen.instant))),
        "usual_distance_m": distance_m,
    }
    for i, name in enumerate(rig.names):
        numbers[f"{name}_position_sigma_mm"] = float(sigma[i] * 1e3)
        numbers[f"{name}_offset_ms"] = float(solved.solution.state.delay_s[i, 0] * 1e3)
    return numbers


def _calibration(
    observations: Observations, rig: Rig, report: CalibrationReport, solved: Solved, new_from_old: SE3
) -> Calibration:
    state, seen = solved.solution.state, solved.seen
    used = np.unique(seen.instant)
    moved = Poses.from_se3(new_from_old)
    prop = Poses(moved.R[None], moved.t[None]) @ state.world_from_prop[used]
    patches = np.unique(seen.patch)
    return Calibration(
        rig, report, coverage(observations), checks.position_sigma_m(solved), state.delay_s, solved.solution.delay_sigma_s,
        middle_ns(observations), np.round(seen.t_s[used] * 1e9).astype(np.int64) + middle_ns(observations), prop.se3(),
        {int(seen.patches[p]): Poses(state.prop_from_patch.R[p], state.prop_from_patch.t[p]).se3() for p in patches},
        seen.camera, seen.xy_img, solved.solution.residual_px,
    )  # fmt: skip
