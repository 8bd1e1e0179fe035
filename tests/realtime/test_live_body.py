"""The whole-body fit of live poses: constant lengths, no memory of a wrong pose, the same whatever came first."""

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from built import detections
from replaying import difference_m, replayed

from posefuse.core import SE3, SKELETONS, Detections2D, LiveDetections, LivePose, LiveStart, Pose3D, Rig
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.foundation.settings import settings_from_mapping
from posefuse.kinematics.body import LIVE_BODY, LiveBodyRules
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import Estimator, warmed_up
from posefuse.realtime.messages import SessionClock
from posefuse.realtime.outputs import notes_of
from posefuse.realtime.session import stop_requests
from posefuse.tracking.online import MOTION
from posefuse_ros.mcap_output import RecordConfig
from posefuse_sim.build import live_scene
from posefuse_sim.scene import Scene

K, PERIOD_NS, BEGIN_NS = len(ANATOMICAL23), 10_000_000, 1_000_000_000
RATE_HZ, LATE_S, SIGMA_PX, SECONDS = 30.0, (0.02, 0.06), 2.0, 3.0
ON, OFF = replace(LiveConfig(), body="on"), replace(LiveConfig(), body="off")
BONES = [
    [ANATOMICAL23.index(f"{side}_{end}") for end in ends]
    for side in ("left", "right")
    for ends in (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))
]
LEFT = [ANATOMICAL23.index(f"left_{joint}") for joint in ("elbow", "wrist", "knee", "ankle")]
Arrivals = list[tuple[int, Detections2D]]


@dataclass(frozen=True, eq=False)
class Walk:
    """Cameras around a person who walks, and what they see, in the order of arrival."""

    rig: Rig
    place: Callable[[np.ndarray], np.ndarray]
    come: Arrivals

    def poses(self, config: LiveConfig, come: Arrivals | None = None, rules: LiveBodyRules = LIVE_BODY) -> list[Pose3D]:
        """At 100 Hz, of the time in which there was a person."""
        estimator = warmed_up(self.rig, ANATOMICAL23, replace(config, joint_centres=False), rules=rules)
        found, waiting = [], list(reversed(come or self.come))
        for t_ns in ticks():
            while waiting and waiting[-1][0] <= t_ns:
                estimator.add(waiting.pop()[1])
            pose = estimator.placed(estimator.tracker.at(t_ns))
            if len(pose.person_id):
                found.append(pose)
        return found

    def error_m(self, poses: list[Pose3D]) -> np.ndarray:
        """(T, K) distances from the truth."""
        true = self.place(np.array([pose.t_ns - BEGIN_NS for pose in poses]) * 1e-9)
        return np.linalg.norm(xyz_of(poses) - true, axis=-1)


def ticks() -> Iterator[int]:
    return iter(range(BEGIN_NS, BEGIN_NS + round(SECONDS * 1e9), PERIOD_NS))


@cache
def walk() -> Walk:
    """Noise is new in every view; every view is late by another time."""
    content = {
        "duration_s": SECONDS, "seed": 3, "cameras": {"kind": "ring", "count": 4},
        "people": [{"motion": {"kind": "walk", "path": {"shape": "circle", "radius_m": 1.4}, "speed_mps": 1.2}}],
    }  # fmt: skip
    scene, rng = live_scene(settings_from_mapping(content, Scene, "test")), np.random.default_rng(1)
    come = []
    for c, camera in enumerate(scene.rig):
        t_s = (np.arange(round(SECONDS * RATE_HZ)) + c / len(scene.rig)) / RATE_HZ
        exact = camera.project(scene.keypoints(t_s)[:, 0])
        for t, xy in zip(t_s, exact + rng.normal(0, SIGMA_PX, exact.shape), strict=True):
            view = view_of(camera.name, BEGIN_NS + round(t * 1e9), xy)
            come.append((view.t_ns + round(1e9 * rng.uniform(*LATE_S)), view))
    return Walk(scene.rig, lambda t_s: scene.keypoints(t_s)[:, 0], sorted(come, key=lambda one: one[0]))


def view_of(camera: str, t_ns: int, xy: np.ndarray) -> Detections2D:
    return detections(camera, xy[None], t_ns, sigma_px=SIGMA_PX, skeleton=ANATOMICAL23)


def xyz_of(poses: list[Pose3D]) -> np.ndarray:
    return np.array([pose.xyz_world[0] for pose in poses])


def apart_m(poses: list[Pose3D], others: list[Pose3D]) -> list[float]:
    return [difference_m(one, two) for one, two in zip(poses, others, strict=True)]


def lengths_m(poses: list[Pose3D]) -> np.ndarray:
    """(T, bones)."""
    xyz = xyz_of(poses)
    return np.stack([np.linalg.norm(xyz[:, a] - xyz[:, b], axis=-1) for a, b in BONES], axis=1)


@cache
def off() -> list[Pose3D]:
    return walk().poses(OFF)


@cache
def on() -> list[Pose3D]:
    return walk().poses(ON)


def fitted(poses: list[Pose3D]) -> list[Pose3D]:
    """Those of the last second: by then lengths were learnt."""
    return poses[-100:]


def test_lengths_learnt_once_are_constant() -> None:
    once = replace(LIVE_BODY, learn_most_s=LIVE_BODY.learn_s)
    assert lengths_m(fitted(off())).std(axis=0).min() > 0.001, "the scene is hard enough"
    assert np.ptp(lengths_m(fitted(walk().poses(ON, rules=once))), axis=0).max() < 0.0001


def test_the_fit_is_nearer_to_the_truth() -> None:
    assert np.nanmean(walk().error_m(fitted(on()))) < np.nanmean(walk().error_m(fitted(off())))


def test_only_places_and_covariances_change() -> None:
    for plain, pose in zip(off(), on(), strict=True):
        np.testing.assert_array_equal(plain.person_id, pose.person_id)
        for name in ("reproj_px", "n_views", "kind"):
            np.testing.assert_array_equal(getattr(plain, name), getattr(pose, name), err_msg=name)
        np.testing.assert_array_equal(np.isnan(plain.xyz_world), np.isnan(pose.xyz_world))
    assert difference_m(off()[-1], on()[-1]) > 0.001


def test_a_covariance_is_the_tracked_one_or_larger_in_all_directions() -> None:
    plain, body = (np.array([pose.cov_world[0] for pose in poses]) for poses in (off(), on()))
    factor = np.trace(body, axis1=-2, axis2=-1) / np.trace(plain, axis1=-2, axis2=-1)
    known = np.isfinite(factor)
    np.testing.assert_allclose(body[known], factor[known][:, None, None] * plain[known], rtol=1e-9)
    assert factor[known].min() >= 1 - 1e-12
    assert np.median(factor[known]) < 1.01, "where views agree it is the same"


def test_kernels_are_not_compiled_to_the_end_for_a_session_that_was_stopped() -> None:
    with pytest.raises(KeyboardInterrupt):
        warmed_up(walk().rig, ANATOMICAL23, OFF, ["SIGTERM"])


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_one_request_to_end_interrupts_the_compiling_of_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """It took a second one, and a session whose program was killed lived on for as long as that takes."""

    def compiles(self: object, view: object) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)
        pytest.fail("it was not interrupted")

    monkeypatch.setattr(Estimator, "add", compiles)
    with pytest.raises(KeyboardInterrupt), stop_requests() as stopped:
        warmed_up(walk().rig, ANATOMICAL23, OFF, stopped)
    assert stopped == ["SIGINT"]


def test_a_tracker_of_other_motion_follows_otherwise() -> None:
    """The benches that fit the constants of motion reach the tracker through this."""
    rig, found = walk().rig, []
    for motion in (MOTION, replace(MOTION, new_share=1.0)):
        estimator = warmed_up(rig, ANATOMICAL23, OFF, motion=motion)
        for _, view in walk().come[:100]:
            estimator.add(view)
        found.append(estimator.tracker.at(walk().come[100][0]))
    assert difference_m(*found) > 0.001


def test_off_there_is_nothing() -> None:
    """And until a skeleton is learnt, both ways give the same to the last bit: nothing of the fit reaches the tracker."""
    assert warmed_up(walk().rig, ANATOMICAL23, OFF).bodies is None
    until_ns = BEGIN_NS + round(LIVE_BODY.learn_s * 1e9)
    begin = sum(pose.t_ns < until_ns for pose in off())
    assert begin > 50 and max(apart_m(off()[:begin], on()[:begin])) == 0.0


def test_auto_waits_for_a_table_that_was_fitted() -> None:
    assert max(apart_m(off(), walk().poses(LiveConfig()))) == 0.0


def test_the_order_of_arrival_between_two_output_ticks_does_not_matter() -> None:
    rng = np.random.default_rng(5)
    tick_of = [-(-(at_ns - BEGIN_NS) // PERIOD_NS) for at_ns, _ in walk().come]
    order = np.lexsort([rng.random(len(tick_of)), tick_of])
    assert (order != np.arange(len(order))).any()
    due = [(BEGIN_NS + tick_of[i] * PERIOD_NS, walk().come[i][1]) for i in order]
    # the cross-check follows the first view after an output, so it may judge another view: no nearer than that
    apart, plain = max(apart_m(on(), walk().poses(ON, due))), max(apart_m(off(), walk().poses(OFF, due)))
    assert apart <= max(1e-6, 2 * plain)


def test_moving_the_world_moves_the_skeleton() -> None:
    turn = SE3(np.array([0.9, 0.1, -0.2, 0.3]) / np.linalg.norm([0.9, 0.1, -0.2, 0.3]), np.array([3.0, -2.0, 0.5]))
    moved = Walk(walk().rig.moved(turn), walk().place, walk().come).poses(ON)
    np.testing.assert_allclose(turn @ xyz_of(on()), xyz_of(moved), atol=2e-4)


def test_limbs_that_two_cameras_put_elsewhere_do_not_end_worse() -> None:
    """From the beginning, as networks invent limbs behind a screen, and they say that they are not so sure."""
    rng = np.random.default_rng(0)
    wrong_px = {name: 120 * unit(rng.normal(size=(len(LEFT), 2))) for name in walk().rig.names[:2]}

    def seen(view: Detections2D) -> Detections2D:
        if view.camera not in wrong_px:
            return view
        xy, sigma = view.xy_img.copy(), view.sigma_px.copy()
        xy[0, LEFT] += wrong_px[view.camera]
        sigma[0, LEFT] *= 3
        return replace(view, xy_img=xy, sigma_px=sigma)

    come = [(at_ns, seen(view)) for at_ns, view in walk().come]
    plain_poses, body_poses = (fitted(walk().poses(config, come)) for config in (OFF, ON))
    plain, body = (walk().error_m(poses)[:, LEFT] for poses in (plain_poses, body_poses))
    assert np.nanmean(plain) > 1.3 * np.nanmean(walk().error_m(fitted(off()))[:, LEFT]), "the scene is hard enough"
    assert np.nanmean(body) < np.nanmean(plain) + 0.01
    assert np.nanpercentile(body, 95) < np.nanpercentile(plain, 95) + 0.03
    # the tracker alone is surer than it is right
    assert nees(body_poses) < 0.8 * nees(plain_poses)


def nees(poses: list[Pose3D]) -> float:
    """Of `LEFT`, 3 where the stated covariance is honest."""
    true = walk().place(np.array([pose.t_ns - BEGIN_NS for pose in poses]) * 1e-9)
    error, cov = (xyz_of(poses) - true)[:, LEFT], np.array([pose.cov_world[0, LEFT] for pose in poses])
    return float(np.nanmean(np.einsum("tki,tkij,tkj->tk", error, np.linalg.inv(cov), error)))


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_a_replay_fits_as_the_session_did(tmp_path: Path) -> None:
    rig, path, clock = walk().rig, tmp_path / "live.mcap", SessionClock.begin()
    sink = RecordConfig(path=path).build()
    sink.take(LiveStart(t_ns=BEGIN_NS, rig=rig, rate_hz=100.0, clock_offset_ns=clock.offset_ns, notes=notes_of(rig, ON)))
    estimator, waiting = warmed_up(rig, ANATOMICAL23, ON), list(reversed(walk().come))
    for t_ns in ticks():
        while waiting and waiting[-1][0] <= t_ns:
            view = waiting.pop()[1]
            sink.take(LiveDetections(detections=view))
            estimator.add(view)
        sink.take(LivePose(pose=estimator.at(t_ns)))
        # as a session does, see `Fusion.run`
        estimator.check()
    sink.close()
    assert max(difference_m(pose, again) for pose, again in replayed(path, rig, ON)) == 0.0
    assert max(difference_m(pose, again) for pose, again in replayed(path, rig, OFF)) > 0.001


# --- every keypoint set of users' networks through the live tracker, hands and face included


FRAME_NS = 33_333_333


@pytest.mark.parametrize("name", ["coco17", "halpe_26", "synthpose_52", "coco_wholebody_133"])
def test_all_keypoints_of_a_set_are_followed(name: str, ring_rig: Callable[..., Rig]) -> None:
    rig, skeleton = ring_rig(4), SKELETONS[name]
    tracker = warmed_up(rig, skeleton, LiveConfig()).tracker
    rest = np.random.default_rng(0).normal(size=(len(skeleton), 3)) * [0.3, 0.3, 0.5] + [0, 0, 1]

    def xyz_at(t_ns: int) -> np.ndarray:
        return rest + [0.3 * (t_ns - 10**9) * 1e-9, 0, 0]

    for i in range(60):
        for c, camera in enumerate(rig):
            t_ns = 10**9 + i * FRAME_NS + c * 3_000_000
            tracker.add(detections(camera.name, camera.project(xyz_at(t_ns))[None], t_ns, sigma_px=1.8, skeleton=skeleton))
    pose = tracker.at(t_ns + 3_000_000)
    assert pose.skeleton == skeleton and len(pose.person_id) == 1
    assert np.linalg.norm(pose.xyz_world[0] - xyz_at(t_ns + 3_000_000), axis=-1).max() < 0.01
