"""Noise that was not fitted to a network has one scale per live session, found from the session's own views."""

from collections.abc import Callable
from types import SimpleNamespace

import built
import numpy as np
import pytest
from no_outputs import KeptOutputs

from posefuse.calibration.clocks.person_tracks import limb_keypoints
from posefuse.core import Detections2D, LiveDetections, LivePose, Rig
from posefuse.core.skeleton import COCO17
from posefuse.realtime import group as group_module
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up
from posefuse.realtime.fusion import Fusion
from posefuse.realtime.messages import Ready, SeenView
from posefuse.realtime.processes import Groups
from posefuse.realtime.rig_watch import RigWatch, RigWatcher, Watched
from posefuse.tracking.settings import LASTING_S, LASTING_SHARE

S = 1_000_000_000
STATED_PX, RATE_HZ, SECONDS = 2.0, 30.0, 14.0
CONFIG = LiveConfig(joint_centres=False, body="off")
LIMBS = limb_keypoints(COCO17.keypoints)


def place(t_s: float | np.ndarray) -> np.ndarray:
    """(..., K, 3) a person who glides to and fro."""
    return built.standing() + 0.5 * np.sin(np.asarray(t_s))[..., None, None] * np.array([1.0, 0.3, 0.0])


def errors(rng: np.random.Generator, steps: int) -> np.ndarray:
    """(T, K, 2) of variance 1, correlated over time as those of networks are."""
    keep, made = np.exp(-1 / RATE_HZ / LASTING_S), rng.standard_normal((steps, len(COCO17), 2))
    lasting = made.copy()
    for i in range(1, steps):
        lasting[i] = keep * lasting[i - 1] + np.sqrt(1 - keep**2) * made[i]
    return np.sqrt(LASTING_SHARE) * lasting + np.sqrt(1 - LASTING_SHARE) * rng.standard_normal(made.shape)


def views(rig: Rig, true_px: float, seed: int = 0) -> list[Detections2D]:
    """Of cameras that do not wait for each other, with errors of `true_px` instead of those stated."""
    found, rng = [], np.random.default_rng(seed)
    for c, camera in enumerate(rig):
        t_s = (np.arange(int(SECONDS * RATE_HZ)) + c / len(rig)) / RATE_HZ
        xy = camera.project(place(t_s)) + true_px * errors(rng, len(t_s))
        found += [
            built.detections(camera.name, points[None], round((1000 + t) * S), sigma_px=STATED_PX)
            for t, points in zip(t_s, xy, strict=True)
        ]
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
def test_the_true_factor_is_found(factor: float, cameras: int, ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(cameras)
    assert found_scale(rig, views(rig, factor * STATED_PX)) == pytest.approx(factor, rel=0.1)


def test_it_is_not_looked_for_unless_asked_nor_found_in_a_few_views(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4)
    seen = views(rig, STATED_PX)
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
    found = []
    for pose in kept.poses():
        if pose.t_ns > 1001 * S and len(pose.person_id):
            off = pose.xyz_world[0] - place(pose.t_ns / S - 1000)
            found.append(np.einsum("ki,kij,kj->k", off, np.linalg.inv(pose.cov_world[0]), off).mean())
    return float(np.mean(found))


@pytest.mark.parametrize("factor", [0.6, 2.0])
def test_with_it_the_stated_covariance_is_nearer_to_the_errors(factor: float, ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4)
    seen = views(rig, factor * STATED_PX, seed=1)[: int(4 * 5 * RATE_HZ)]
    without, scaled = (abs(nees(session(rig, seen, scale)[1]) - 3) for scale in (None, factor))
    assert scaled < without


def test_what_is_recorded_is_scaled_so_a_replay_gives_the_same_poses(ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4)
    fusion, kept = session(rig, views(rig, STATED_PX)[:600], 1.4)
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


def test_the_first_scale_holds(ring_rig: Callable[..., Rig]) -> None:
    watch = KnownWatch(Watched())
    later = [Watched(noise_scale=0.9), Watched(noise_scale=1.4)]
    watch._worker = SimpleNamespace(receive=lambda: later.pop() if later else None, due=lambda: False)
    watch.receive()
    assert watch.known.noise_scale == 1.4


@pytest.mark.parametrize("network", [{}, {"unknown": "noise not fitted, keypoints"}, {"unknown": "keypoints"}])
def test_a_group_states_whether_the_noise_of_its_network_was_fitted(network: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    detector = SimpleNamespace(skeleton=COCO17, joint_centres=None, network=network)
    group = SimpleNamespace(detector=detector)
    monkeypatch.setattr(group_module, "Group", lambda plan, channel: group)
    sent: list[Ready] = []
    group_module._opened(None, SimpleNamespace(send=lambda message, wait_s: sent.append(message)))
    groups = Groups([])
    groups._members = [SimpleNamespace(marks=sent[0])]
    assert groups.noise_fitted == ("noise not fitted" not in network.get("unknown", ""))
