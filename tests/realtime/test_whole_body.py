"""Every keypoint set of users' networks through the live tracker, hands and face included."""

from collections.abc import Callable

import numpy as np
import pytest
from built import detections

from posefuse.core import SKELETONS, Rig
from posefuse.realtime.config import LiveConfig
from posefuse.realtime.estimator import warmed_up

PERIOD_NS, STAGGER_NS, SPEED_M_S = 33_333_333, 3_000_000, 0.3


@pytest.mark.parametrize("name", ["coco17", "halpe_26", "synthpose_52", "coco_wholebody_133"])
def test_all_keypoints_of_a_set_are_followed(name: str, ring_rig: Callable[..., Rig]) -> None:
    rig, skeleton = ring_rig(4), SKELETONS[name]
    tracker = warmed_up(rig, skeleton, LiveConfig()).tracker
    rest = np.random.default_rng(0).normal(size=(len(skeleton), 3)) * [0.3, 0.3, 0.5] + [0, 0, 1]

    def xyz_at(t_ns: int) -> np.ndarray:
        return rest + [SPEED_M_S * (t_ns - 10**9) * 1e-9, 0, 0]

    for i in range(60):
        for c, camera in enumerate(rig):
            t_ns = 10**9 + i * PERIOD_NS + c * STAGGER_NS
            tracker.add(detections(camera.name, camera.project(xyz_at(t_ns))[None], t_ns, sigma_px=1.8, skeleton=skeleton))
    pose = tracker.at(t_ns + STAGGER_NS)
    assert pose.skeleton == skeleton and len(pose.person_id) == 1
    off_m = np.linalg.norm(pose.xyz_world[0] - xyz_at(t_ns + STAGGER_NS), axis=-1)
    assert off_m.max() < 0.01
