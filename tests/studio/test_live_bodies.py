"""Meshes of a live session: few slots, each new mesh sent once."""

from dataclasses import replace

import numpy as np
import pytest

from posefuse.core import Pose3D
from posefuse.formats.truth import read_truth
from posefuse.kinematics import JointTracker
from posefuse.pipeline.demo_clip import clip_folder
from posefuse.studio.live_bodies import LiveBodies

RGBA = [(1, 2, 3, 255)] * 4


@pytest.fixture(scope="module")
def poses() -> list[Pose3D]:
    """The bundled clip's exact poses, ten a second."""
    truth = read_truth(clip_folder() / "truth" / "truth.npz")
    shape = truth.xyz_world.shape[1:3]
    return [
        Pose3D(
            t_ns=k * 100_000_000,
            skeleton=truth.skeleton,
            person_id=truth.person_id,
            xyz_world=truth.xyz_world[3 * k],
            cov_world=np.tile(1e-4 * np.eye(3), (*shape, 1, 1)),
            reproj_px=np.ones(shape),
            n_views=np.full(shape, 4),
            kind=np.ones(shape),
        )
        for k in range(24)
    ]


def played(bodies: LiveBodies, poses: list[Pose3D], person: int) -> list[tuple[dict[int, bytes], bytes]]:
    poses = [replace(pose, person_id=np.array([person])) for pose in poses]
    tracker = JointTracker(poses[0].skeleton)
    return [bodies.step(pose.t_ns / 1e9, pose, tracker.step(pose), RGBA) for pose in poses]


def test_a_mesh_is_sent_when_it_is_made_and_bodies_with_every_step(poses: list[Pose3D]) -> None:
    found = played(LiveBodies(), poses, 3)
    assert [i for i, (meshes, _) in enumerate(found) if meshes] == [9, 19]
    counts = [int.from_bytes(message[16:20], "little") for _, message in found]
    assert counts == [0] * 9 + [1] * 15
    assert int.from_bytes(found[-1][1][20:24], "little") == 3
    # the newest mesh is the one that is moved
    assert found[19][0][0][16:20] == found[-1][1][24:28] != found[9][0][0][16:20]


def test_a_slot_is_used_again_and_never_moves_the_former_mesh(poses: list[Pose3D]) -> None:
    bodies = LiveBodies()
    first = played(bodies, poses[:10], 1)[9]
    later = [replace(pose, t_ns=pose.t_ns + 60_000_000_000) for pose in poses[:10]]
    second = played(bodies, later, 2)[9]
    assert list(first[0]) == list(second[0]) == [0]
    assert first[1][24:26] == second[1][24:26] and first[1][26:28] != second[1][26:28]
