"""Where the cameras are, from a moving prop or board: solve, check, set the world, or refuse by name."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from posefuse.calibration.clocks.sync import ClockEstimate
from posefuse.calibration.report import CalibrationReport, Check, RefusedCalibration
from posefuse.calibration.targets.corners import CornerObservations
from posefuse.calibration.targets.coverage import TargetCoverage, coverage
from posefuse.calibration.targets.kinds import Target, check_one_end
from posefuse.core import SE3, CalibrationError, Camera, Rig
from posefuse.core.arrays import Array

from . import self_checks as checks
from .bootstrap import rough_offsets
from .causes import cause_check, likely_target_causes
from .freedoms import IN_STEP
from .pipeline import Options, RigTask, Solved, solve, starting_clocks
from .self_checks import check_same_video_by_corners, check_target_size, solution_checks
from .snapshots import middle_ns
from .world import UP_FROM_CAMERAS, WorldRule, aligned

_UNSYNCHRONISED_S = 0.02
# checks whose failure names its cause
SAID_BY_ITSELF = (
    "target seen",
    "target moves",
    "marker ids are unique",
    "videos differ",
    "images are upright",
    "target has a plausible size",
    "rig has a plausible size",
    "recording carries the intrinsics",
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """A rig that passed its checks, and what it came from.

    Attributes:
        rig: in the world asked for. report: the checks. coverage: of the recording. clocks: against the reference camera.
        position_cov_m2: (C, 3, 3) of each camera's place against the reference camera, in world coordinates.
    """

    rig: Rig
    report: CalibrationReport
    coverage: TargetCoverage
    position_cov_m2: Array
    clocks: ClockEstimate


def calibrate_extrinsics(
    observations: CornerObservations,
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
        target: loose markers on a rigid prop, or a ChArUco board.
        options: how to solve. world: how the world frame is set; without one, up is guessed from the cameras.
        upside_down: cameras that really hang upside down.

    Raises:
        CalibrationError: input that cannot be used. RefusedCalibration (one of them, with the report): a check fails.
    """
    options = options or Options()
    intrinsics = Rig(tuple(replace(camera, cam_from_world=SE3.identity()) for camera in cameras))
    _check_input(observations, intrinsics, target)
    task = RigTask(aligned(observations, intrinsics), intrinsics.cameras, target, options)
    rule = world or UP_FROM_CAMERAS
    first = _attempt(task, rule, upside_down, "together" if options.clocks == "auto" else options.clocks)
    if options.clocks != "auto" or not first.failed or not _may_be_clocks(first):
        return _explained(first, rule)
    second = _attempt(task, rule, upside_down, "offset")
    if second.solved is None:
        return _explained(first, rule)
    note = "the cameras are not synchronised: their clock offsets were estimated and must be applied when they are used"
    if second.failed:
        note = f"taken as synchronised it is refused as well: {'; '.join(check.line for check in first.failed[:2])}"
    return _explained(replace(second, notes=(note,)), rule)


@dataclass(frozen=True, eq=False)
class _Attempt:
    """A solution with its checks, or how far it came.

    Attributes:
        task: that was tried. done: checks. solved: None where the cameras could not be linked. notes: besides those of the
            solution.
    """

    task: RigTask
    done: tuple[Check, ...]
    solved: Solved | None
    notes: tuple[str, ...] = ()

    @property
    def failed(self) -> tuple[Check, ...]:
        return tuple(check for check in self.done if not check.passed)

    @property
    def says_why(self) -> bool:
        """Whether a check failed that names its cause."""
        return any(check.name in SAID_BY_ITSELF for check in self.failed)


def _attempt(task: RigTask, rule: WorldRule, upside_down: tuple[str, ...], clocks: str) -> _Attempt:
    """Solve and check as far as that goes."""
    task = replace(task, options=replace(task.options, clocks=clocks))
    done: list[Check] = [
        checks.check_target_seen(task.observations), checks.check_target_moves(task.observations),
        checks.check_doubled(task.observations),
        check_same_video_by_corners(task.observations), check_target_size(task.target),
    ]  # fmt: skip
    if any(not check.passed for check in done):
        return _Attempt(task, tuple(done), None)
    solved: Solved | None = None
    try:
        solved = solve(task, starting_clocks(task))
        done += solved.checks
        done += solution_checks(task, solved)
        done += world_checks(_in_world(solved, rule)[0], rule.has_floor, upside_down)
    except RefusedCalibration as refused:
        return _Attempt(task, (*done, *refused.report.checks), solved)
    return _Attempt(task, tuple(done), solved)


def _explained(attempt: _Attempt, rule: WorldRule) -> Calibration:
    """The calibration; where checks fail, the refusal with its likely cause in front."""
    task, solved = attempt.task, attempt.solved
    if not attempt.failed:
        assert solved is not None
        return _calibration(attempt, solved, rule)
    # what speaks for itself first: it explains the others (an image upside down, where its principal point seems to be)
    done = tuple(sorted(attempt.done, key=lambda check: check.passed or check.name not in SAID_BY_ITSELF))
    if not attempt.says_why:
        less = None if solved is None else solved.thinned
        causes = likely_target_causes(task, less)
        # blur leaves few markers, which no residual shows
        sharp = checks.check_sharp(task.observations)
        named = (cause_check(causes, less),) if causes else () if sharp.passed else (sharp,)
        done = (*named, *done)
    if solved is None:
        raise RefusedCalibration(CalibrationReport("extrinsics", done, attempt.notes))
    kept = _calibration(replace(attempt, done=done), solved, rule)
    raise RefusedCalibration(kept.report, kept)


def _in_world(solved: Solved, rule: WorldRule) -> tuple[Rig, SE3]:
    """The rig in the world asked for, and the motion that takes it there."""
    rig = _rig(solved)
    new_from_old = rule.new_from_old(rig)
    return replace(rig.moved(new_from_old), world_set_by=rule.words), new_from_old


def _may_be_clocks(attempt: _Attempt) -> bool:
    """Whether a refused attempt that took the cameras as synchronised may fail for their clocks."""
    task = attempt.task
    if attempt.says_why:
        return False
    if any(check.name == IN_STEP for check in attempt.failed):
        return True
    late = rough_offsets(task.observations, task.cameras, task.target)
    return bool(np.isfinite(late).any() and (np.abs(late - np.nanmedian(late)) > _UNSYNCHRONISED_S).any())


def _check_input(observations: CornerObservations, intrinsics: Rig, target: Target) -> None:
    check_one_end(target)
    if len(intrinsics) < 2:
        raise CalibrationError(f"extrinsics: expected at least 2 cameras, got {len(intrinsics)}")
    without = [name for name in intrinsics.names if name not in observations.cameras]
    if without:
        raise CalibrationError(
            f"extrinsics: no observations of camera {', '.join(without)}; there are: {', '.join(observations.cameras)}"
        )


def _rig(solved: Solved) -> Rig:
    pose = solved.solution.state.cam_from_world.se3()
    placed = tuple(replace(camera, cam_from_world=pose[i]) for i, camera in enumerate(solved.refined))
    good = solved.inlier[solved.seen.group]
    rms = float(np.sqrt((solved.solution.residual_px[good] ** 2).sum(axis=1).mean()))
    return Rig(placed, residual_px=rms)


def _clocks(task: RigTask, solved: Solved) -> ClockEstimate:
    """Against the camera whose clock was held."""
    late = solved.solution.state.delay_s
    (offset_s, drift), (offset_sigma_s, drift_sigma) = (late - late[solved.links.reference]).T, solved.solution.delay_sigma_s.T
    return ClockEstimate(offset_s, drift, offset_sigma_s, drift_sigma, middle_ns(task.observations) / 1e9)


def world_checks(rig: Rig, has_floor: bool, upside_down: tuple[str, ...] = ()) -> list[Check]:
    """Checks that need the world: cameras above the floor, images upright, which they are not in a world whose floor is wrong."""
    done = []
    if has_floor:
        height = rig.centres_world()[:, 2]
        worst = int(np.argmin(height))
        done.append(
            Check("cameras are above the floor", bool(height[worst] > 0),
                  f"the lowest is {rig.names[worst]} at {height[worst]:.2f} m",
                  "the tile lies face down, is described mirrored or is not on the floor"),
        )  # fmt: skip
    up_cam = np.stack([camera.cam_from_world.matrix()[:, 2] for camera in rig])
    up_cam = np.where(np.isin(rig.names, upside_down)[:, None], -up_cam, up_cam)
    return [*done, checks.check_upright(rig.cameras, up_cam)]


def _notes(solved: Solved) -> tuple[str, ...]:
    notes = [f"marker {patch} left out: {reason}" for patch, reason in sorted(solved.dropped.items())]
    share = float(solved.inlier.mean())
    if share < 1:
        notes.append(f"{1 - share:.1%} of the marker views disagree and count little")
    return tuple(notes)


def _numbers(solved: Solved, rig: Rig, clocks: ClockEstimate) -> dict[str, float]:
    sigma = checks.position_sigma_m(solved)
    numbers = {
        "residual_px": rig.residual_px,
        "sigma_px": solved.solution.sigma_px,
        "time_steps": float(len(np.unique(solved.seen.time_step))),
        "usual_distance_m": float(np.median(solved.distance_m)),
    }
    for i, name in enumerate(rig.names):
        numbers[f"{name}_position_sigma_mm"] = float(sigma[i] * 1e3)
        numbers[f"{name}_offset_ms"] = float(clocks.offset_s[i] * 1e3)
    return numbers


def _calibration(attempt: _Attempt, solved: Solved, rule: WorldRule) -> Calibration:
    task, done = attempt.task, attempt.done
    rig, new_from_old = _in_world(solved, rule)
    failed = [check.name for check in done if not check.passed]
    if failed:
        rig = replace(rig, refused=", ".join(failed))
    turn, clocks = new_from_old.matrix(), _clocks(task, solved)
    notes = (*_notes(solved), *attempt.notes)
    return Calibration(
        rig=rig,
        report=CalibrationReport("extrinsics", done, notes, _numbers(solved, rig, clocks)),
        coverage=coverage(task.observations),
        position_cov_m2=turn @ checks.position_cov_m2(solved) @ turn.T,
        clocks=clocks,
    )
