"""The rig watched next to a live session: views at own times, what is found of them, of clocks, and the process that does it."""

import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import built
import numpy as np
import pytest
from built import turned
from live_session import until
from no_outputs import KeptOutputs

from posefuse.calibration.clocks.person_tracks import limb_keypoints
from posefuse.core import Detections2D, LiveDetections, LivePose, Rig, Truth
from posefuse.core.skeleton import COCO17
from posefuse.core.view_sequences import ViewSequence
from posefuse.formats.truth import read_truth
from posefuse.health.clock_finding import ClockFinder
from posefuse.health.misalignment import CommonTimeSteps
from posefuse.realtime import group as group_module
from posefuse.realtime.capture import LOOP_PAUSE_S
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.realtime.fusion_loop import Fusion
from posefuse.realtime.messages import Ready, SeenView
from posefuse.realtime.processes import Groups
from posefuse.realtime.rig_watch import RigWatch, RigWatcher, Watched, watching
from posefuse.tracking.settings import LASTING_S, LASTING_SHARE
from posefuse_sim.oracle import OracleNoise, oracle_views

S = 1_000_000_000
RATE_HZ = 30.0
PHASE_S = (0.0, 0.011, 0.023, 0.029)


@pytest.fixture(scope="module")
def truth(demo_session: Path) -> Truth:
    return read_truth(demo_session / "truth" / "truth.npz")


def line(t_ns: int) -> np.ndarray:
    """(2, 2) points that move evenly."""
    return np.array([[100.0, 50.0], [200.0, 80.0]]) + np.array([[30.0, -10.0], [0.0, 4.0]]) * t_ns / S


def test_views_are_read_at_common_time_steps_wherever_they_lie() -> None:
    time_steps, rng = CommonTimeSteps(("a", "b")), np.random.default_rng(1)
    times = [("ab"[c], int(t_ns)) for c in range(2) for t_ns in np.cumsum(rng.integers(20_000_000, 120_000_000, 60))]
    read = []
    for name, t_ns in sorted(times, key=lambda one: one[1]):
        time_steps.add(name, t_ns, line(t_ns), np.ones(2, bool))
        read += list(time_steps.ready())
    assert len(read) > 20
    assert (np.diff([t_ns for t_ns, _ in read]) == S // 10).all()
    for t_ns, xy in read:
        known = np.isfinite(xy).all(axis=(1, 2))
        np.testing.assert_allclose(xy[known], np.stack([line(t_ns)] * known.sum()), atol=1e-9)
    assert np.isfinite([xy for _, xy in read[2:]]).all()


def test_a_camera_that_is_silent_is_nan_and_one_that_is_ahead_pushes_no_person() -> None:
    time_steps, read = CommonTimeSteps(("a", "b", "c")), []
    for step in range(90):
        for name, ahead_ns in (("a", 0), ("b", 0), ("c", 3600 * S)):
            if name != "b" or step < 30:
                t_ns = step * S // 30
                time_steps.add(name, t_ns + ahead_ns, line(t_ns), np.ones(2, bool))
        read += list(time_steps.ready())
    assert read[-1][0] == 24 * S // 10
    assert all(np.isfinite(xy[0]).all() and np.isnan(xy[2]).all() for _, xy in read[5:])
    assert np.isfinite(read[5][1][1]).all()
    assert np.isnan(read[-1][1][1]).all()


@pytest.mark.parametrize(("apart_s", "there"), [(0.1, True), (0.2, False)])
def test_views_far_apart_are_not_read_between(apart_s: float, there: bool) -> None:
    time_steps, read = CommonTimeSteps(("a", "b")), []
    for i in range(60):
        for name, late_s in (("a", 0.0), ("b", 0.03)):
            time_steps.add(name, round((i * apart_s + late_s) * S), line(0), np.ones(2, bool))
        read += list(time_steps.ready())
    assert (len(read) > 10) == there


def test_nothing_is_read_across_a_gap_nor_where_a_point_was_not_seen() -> None:
    back, gaps = CommonTimeSteps(("a", "b")), {}
    for t_ns in (*range(0, S, S // 30), *range(2 * S, 3 * S, S // 30)):
        back.add("a", t_ns, line(t_ns), np.ones(2, bool))
        back.add("b", t_ns, line(t_ns), np.array([True, False]))
        gaps |= dict(back.ready())
    assert any(t_ns < S for t_ns in gaps)
    assert any(t_ns > 2 * S for t_ns in gaps)
    assert not any(S < t_ns < 2 * S for t_ns in gaps)
    assert all(np.isnan(xy[1, 1]).all() for xy in gaps.values())


def test_memory_stays_bounded() -> None:
    time_steps = CommonTimeSteps(("a", "b"))
    for step in range(2000):
        time_steps.add("a", step * S // 30, line(0), np.ones(2, bool))
    assert len(time_steps._views["a"]) <= 256


def limbs_at(truth: Truth, t_s: float) -> np.ndarray:
    """(L, 3) between the frames of the clip."""
    at = t_s * 1e9 * (len(truth.t_ns) - 1) / (truth.t_ns[-1] - truth.t_ns[0])
    i = min(int(at), len(truth.t_ns) - 2)
    before, after = truth.xyz_world[i : i + 2, 0, limb_keypoints(truth.skeleton.keypoints)]
    return before + (at - i) * (after - before)


def errors(rng: np.random.Generator, steps: int, *of: int) -> np.ndarray:
    """(T, ..., 2) of variance 1, correlated over time as those of networks are."""
    keep, made = np.exp(-1 / RATE_HZ / LASTING_S), rng.standard_normal((steps, *of, 2))
    lasting = made.copy()
    for i in range(1, steps):
        lasting[i] = keep * lasting[i - 1] + np.sqrt(1 - keep**2) * made[i]
    return np.sqrt(LASTING_SHARE) * lasting + np.sqrt(1 - LASTING_SHARE) * rng.standard_normal(made.shape)


def fed(watcher: RigWatcher, truth: Truth, rig: Rig, begin_s: float, seconds: float) -> dict[str, str]:
    """Kinds found by camera, after the clip was shown as cameras at `rig` see it, each at times of its own.

    Errors of 4 px last from frame to frame as those of the default network do.
    """
    last_s, limbs = (truth.t_ns[-1] - truth.t_ns[0]) / 1e9, limb_keypoints(truth.skeleton.keypoints)
    steps = round(seconds * RATE_HZ)
    off_px = 4.0 * errors(np.random.default_rng(5), steps, len(rig), len(limbs))
    for step in range(steps):
        for c, camera in enumerate(rig):
            t_s = begin_s + step / RATE_HZ + PHASE_S[c]
            # to and fro, so that no person jumps
            seen = camera.project(limbs_at(truth, abs((t_s + last_s) % (2 * last_s) - last_s))) + off_px[step, c]
            watcher.add(camera.name, round((1000 + t_s) * S), seen, np.ones(len(seen)))
        known = watcher.look()
    return {name: verdict.state for name, verdict in known.faulty.items()}


def test_a_moved_camera_is_found_among_cameras_that_do_not_wait_for_each_other(truth: Truth) -> None:
    rig, watcher = truth.rig, RigWatcher(truth.rig, clocks=False)
    assert fed(watcher, truth, rig, 0.0, 5.0) == {}
    assert fed(watcher, truth, turned(rig, 2, [0.02, 0.01, 0.0]), 5.0, 5.0) == {rig.names[2]: "moved"}
    # put back it is correct, and may be moved again
    assert fed(watcher, truth, rig, 10.0, 6.0) == {}
    assert fed(watcher, truth, turned(rig, 2, [0.02, 0.01, 0.0]), 16.0, 5.0) == {rig.names[2]: "moved"}


def found_in_a_loop(truth: Truth, pause_s: float) -> set[str]:
    """What is said of healthy cameras while a clip of a walking person begins again every two seconds, after a pause."""
    rng, watcher, said = np.random.default_rng(2), RigWatcher(truth.rig, clocks=False), set()
    for step in range(round(9 * RATE_HZ)):
        for c, camera in enumerate(truth.rig):
            t_s = step / RATE_HZ + PHASE_S[c]
            xy = camera.project(limbs_at(truth, t_s % 2))
            shown_s = t_s + int(t_s / 2) * pause_s
            watcher.add(camera.name, round((1000 + shown_s) * S), xy + rng.normal(0, 1.0, xy.shape), np.ones(len(xy)))
        if step % 8 == 0:
            said |= {verdict.state for verdict in watcher.look().faulty.values()}
    return said


def test_the_pause_of_a_looped_source_is_what_keeps_healthy_cameras_from_being_blamed(truth: Truth) -> None:
    assert found_in_a_loop(truth, pause_s=LOOP_PAUSE_S) == set()
    assert found_in_a_loop(truth, pause_s=0.0) != set()


def test_two_cameras_are_not_watched(truth: Truth) -> None:
    two = Rig(truth.rig.cameras[:2])
    with watching(two, clocks=False, noise=False) as watch:
        assert watch is None
    assert fed(RigWatcher(two, clocks=False), truth, turned(two, 0, [0.0, 0.1, 0.1]), 0.0, 4.0) == {}


def test_a_watch_that_is_killed_is_reported_and_ends_nothing(truth: Truth) -> None:
    view = Detections2D.empty("cam00", 5 * S, truth.skeleton)
    with RigWatch(truth.rig, clocks=True) as watch:
        pid = int(watch.whereabouts().split()[-1])
        assert watch.corrected(view, 1) is view
        assert watch.trouble == ""
        os.kill(pid, signal.SIGKILL)

        def use() -> None:
            assert watch.corrected(view, 1).t_ns == view.t_ns
            watch.receive()

        until(lambda: bool(watch.trouble), use)
    assert f"process {pid} ended" in watch.trouble
    with RigWatch(truth.rig, clocks=False) as watch:
        pid = int(watch.whereabouts().split()[-1])
    assert not Path(f"/proc/{pid}").exists()


# --- clock offsets of cameras on several machines, from what the oracle sees of a walking person


Offsets = np.ndarray | Callable[[float], np.ndarray]
MACHINES_S = np.array([0.0, 0.05, 0.0, 0.05])


@pytest.fixture(scope="module")
def views(truth: Truth) -> ViewSequence:
    """As the default network errs: 1.2 px again in every frame, 4 px that stay with a camera and keypoint; and some wild ones."""
    return oracle_views(truth, OracleNoise(sigma_px=1.2, bias_px=4.0, outlier_share=0.03), seed=4)


def late_of(
    truth: Truth, views: ViewSequence, offset_s: Offsets, seconds: float, rate_hz: float = RATE_HZ, seed: int = 0
) -> np.ndarray | None:
    """(C,) s found after some seconds of the clip, played again and again from any moment, with frames lost at random.

    Offsets in s, or what they are at a time in s.
    """
    finder, limbs, rng = ClockFinder(truth.rig), limb_keypoints(truth.skeleton.keypoints), np.random.default_rng(seed)
    frames, found = len(truth.t_ns), None
    begin = int(rng.integers(frames))
    for step in range(round(seconds * RATE_HZ)):
        for c, name in enumerate(truth.rig.names):
            if rng.random() < rate_hz / RATE_HZ:
                f, t_s = (begin + step) % frames, step / RATE_HZ
                t_s += (offset_s(t_s) if callable(offset_s) else offset_s)[c]
                finder.add(name, 10**15 + round(t_s * 1e9), views.xy_img[f, 0, c][limbs], views.score[f, 0, c][limbs])
        if step % 30 == 29:
            found = finder.find() or found
    return found and np.array([found[name] for name in truth.rig.names])


@pytest.mark.parametrize("rate_hz", [30.0, 8.0])
def test_two_machines_clocks_are_found_even_when_most_frames_are_lost(truth: Truth, views: ViewSequence, rate_hz: float) -> None:
    off_ms = []
    for seed in range(3):
        late_s = late_of(truth, views, MACHINES_S, 16.0, rate_hz, seed)
        off_ms.append(1000 * (late_s[[1, 3]].mean() - late_s[[0, 2]].mean() - 0.05))
    assert np.abs(off_ms).max() < 5.0


def test_every_camera_has_its_own_and_their_mean_is_zero(truth: Truth, views: ViewSequence) -> None:
    offset_s = np.array([0.0, 0.25, -0.02, 0.13])
    late_s = late_of(truth, views, offset_s, 16.0)
    np.testing.assert_allclose(late_s, offset_s - offset_s.mean(), atol=0.005)
    assert abs(late_s.mean()) < 1e-6


def test_what_cannot_be_known_is_not_reported(truth: Truth, views: ViewSequence) -> None:
    assert late_of(truth, views, MACHINES_S, 2.0) is None
    planes = ("xy_img", "score", "sigma_px")
    still = replace(views, **{name: np.broadcast_to(getattr(views, name)[:1], getattr(views, name).shape) for name in planes})
    assert late_of(truth, still, MACHINES_S, 8.0) is None
    alone = ClockFinder(truth.rig)
    for i in range(100):
        alone.add("cam00", i * 33_000_000, views.xy_img[i, 0, 0], views.score[i, 0, 0])
    assert alone.find() is None


def test_seconds_in_which_no_keypoint_is_sure_end_nothing(truth: Truth, views: ViewSequence) -> None:
    unsure = replace(views, score=np.where(np.arange(len(views.score))[:, None, None, None] < 150, 0.01, views.score))
    late_s = late_of(truth, unsure, MACHINES_S, 24.0)
    assert late_s[[1, 3]].mean() - late_s[[0, 2]].mean() == pytest.approx(0.05, abs=0.005)


def test_a_clock_that_is_set_is_followed(truth: Truth, views: ViewSequence) -> None:
    late_s = late_of(truth, views, lambda t_s: 0.03 * np.eye(4)[2] * (t_s > 20), 50.0)
    assert late_s[2] - late_s[[0, 1, 3]].mean() == pytest.approx(0.03, abs=0.012)


# --- noise that was not fitted to a network has one scale per live session, found from the session's own views


STATED_PX, SECONDS = 2.0, 14.0
CONFIG = LiveConfig(joint_centres=False, body="off")
LIMBS = limb_keypoints(COCO17.keypoints)


def place(t_s: float | np.ndarray) -> np.ndarray:
    """(..., K, 3) a person who glides to and fro."""
    return built.standing() + 0.5 * np.sin(np.asarray(t_s))[..., None, None] * np.array([1.0, 0.3, 0.0])


def seen_with(rig: Rig, true_px: float, seed: int = 0) -> list[Detections2D]:
    """Of cameras that do not wait for each other, with errors of `true_px` instead of those stated."""
    found, rng = [], np.random.default_rng(seed)
    for c, camera in enumerate(rig):
        t_s = (np.arange(int(SECONDS * RATE_HZ)) + c / len(rig)) / RATE_HZ
        xy = camera.project(place(t_s)) + true_px * errors(rng, len(t_s), len(COCO17))
        for t, points in zip(t_s, xy, strict=True):
            found.append(built.detections(camera.name, points[None], round((1000 + t) * S), sigma_px=STATED_PX))
    return sorted(found, key=lambda view: view.t_ns)


def found_scale(rig: Rig, seen: list[Detections2D]) -> float | None:
    """What the watch finds of these views; every second one of each camera goes to it."""
    watcher = RigWatcher(rig, clocks=False, noise=True)
    for i, view in enumerate(seen):
        if i // len(rig) % 2:
            points = np.column_stack([view.xy_img[0, LIMBS], view.sigma_px[0, LIMBS]])
            watcher.add(view.camera, view.t_ns, points, view.score[0, LIMBS])
            watcher.look()
    return watcher.look().noise_scale


@pytest.mark.parametrize("cameras", [2, 4, 7])
@pytest.mark.parametrize("factor", [0.7, 1.0, 2.0])
def test_the_true_factor_is_found(factor: float, cameras: int, ring_rig) -> None:
    rig = ring_rig(cameras)
    assert found_scale(rig, seen_with(rig, factor * STATED_PX)) == pytest.approx(factor, rel=0.1)


def test_it_is_not_looked_for_unless_asked_nor_found_in_a_few_views(ring_rig) -> None:
    rig = ring_rig(4)
    seen = seen_with(rig, STATED_PX)
    assert found_scale(rig, seen[: len(seen) // 4]) is None
    assert RigWatcher(rig, clocks=False).look().noise_scale is None


class KnownWatch(RigWatch):
    """A watch that has found this already, without a process."""

    def __init__(self, known: Watched) -> None:
        self.known = known

    def corrected(self, view: Detections2D, followed: int) -> Detections2D:
        return super().corrected(view, followed=2)


def session(rig: Rig, seen: list[Detections2D], scale: float | None) -> tuple[Fusion, KeptOutputs]:
    """A session with these views, an output 50 times a second."""
    clock, kept = SimpleNamespace(now_ns=lambda: clock.now), KeptOutputs()
    watch = KnownWatch(Watched(noise_scale=scale))
    fusion = Fusion(rig, warmed_up(rig, COCO17, CONFIG), lambda _: None, clock, kept, watch=watch)
    due_ns = seen[0].t_ns
    for view in seen:
        clock.now = view.t_ns + S // 25
        while due_ns <= clock.now:
            fusion.tick(due_ns, S // 50)
            fusion.estimator.check()
            due_ns += S // 50
        fusion.take(SeenView(detections=view, state=None, received_ns=clock.now, started_ns=clock.now, detected_ns=clock.now))
    return fusion, kept


def nees(kept: KeptOutputs) -> float:
    """Of the poses from the second second on."""
    poses = [pose for pose in kept.poses() if pose.t_ns > 1001 * S and len(pose.person_id)]
    off = np.array([pose.xyz_world[0] - place(pose.t_ns / S - 1000) for pose in poses])
    return float(np.einsum("tki,tkij,tkj->tk", off, np.linalg.inv([pose.cov_world[0] for pose in poses]), off).mean())


@pytest.mark.parametrize("factor", [0.6, 2.0])
def test_with_it_the_stated_covariance_is_nearer_to_the_errors(factor: float, ring_rig) -> None:
    rig = ring_rig(4)
    seen = seen_with(rig, factor * STATED_PX, seed=1)[: int(4 * 5 * RATE_HZ)]
    without, scaled = (abs(nees(session(rig, seen, scale)[1]) - 3) for scale in (None, factor))
    assert scaled < without


def test_what_is_recorded_is_scaled_so_a_replay_gives_the_same_poses(ring_rig) -> None:
    rig = ring_rig(4)
    fusion, kept = session(rig, seen_with(rig, STATED_PX)[:600], 1.4)
    again, recorded = warmed_up(rig, COCO17, CONFIG), 0
    for message in kept.offered:
        if isinstance(message, LiveDetections):
            np.testing.assert_array_equal(message.detections.sigma_px, np.float32(STATED_PX) * np.float32(1.4))
            again.add(message.detections)
        elif isinstance(message, LivePose):
            np.testing.assert_array_equal(again.at(message.pose.t_ns).xyz_world, message.pose.xyz_world)
            again.check()
            recorded += len(message.pose.person_id)
    assert recorded > 100
    assert fusion.noise_scale == 1.4


def test_the_first_scale_holds(ring_rig) -> None:
    watch = KnownWatch(Watched())
    later = [Watched(noise_scale=0.9), Watched(noise_scale=1.4)]
    watch._worker = SimpleNamespace(receive=lambda: later.pop() if later else None, due=lambda: False)
    watch.receive()
    assert watch.known.noise_scale == 1.4


@pytest.mark.parametrize("network", [{}, {"unknown": "noise not fitted, keypoints"}, {"unknown": "keypoints"}])
def test_a_group_states_whether_the_noise_of_its_network_was_fitted(network: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    detector = SimpleNamespace(skeleton=COCO17, joint_centres=None, network=network)
    monkeypatch.setattr(group_module, "Group", lambda plan, channel: SimpleNamespace(detector=detector))
    sent: list[Ready] = []
    group_module._opened(None, SimpleNamespace(send=lambda message, wait_s: sent.append(message)))
    groups = Groups([])
    groups._members = [SimpleNamespace(marks=sent[0])]
    assert groups.noise_fitted == ("noise not fitted" not in network.get("unknown", ""))
