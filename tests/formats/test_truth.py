"""The truth file: what is written is read, byte for byte the same for the same values."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from built import joint_angles
from checks import assert_same, refusal

from posefuse.core import SE3, CameraTruth, InputError, Truth
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.formats.truth import read_truth, write_truth


def _truth(ring_rig, joints: bool = True) -> Truth:
    rng = np.random.default_rng(4)
    rig, views = ring_rig(3, distortion=(-0.2, 0.05, 0.001, 0.002)), []
    for name, f in zip(rig.names, (4, 6, 5), strict=True):
        xy, visible = rng.uniform(0, 600, (f, 2, 23, 2)), rng.random((f, 2, 23)) > 0.5
        views.append(CameraTruth(camera=name, t_ns=np.arange(f) * 30_000_000 + 7, xy_img=xy, visible=visible))
    pose = SE3.from_rotvec(rng.normal(size=(5, 2, 4, 3)), rng.normal(size=(5, 2, 4, 3)))
    people = {"t_ns": np.arange(5) * 40_000_000, "person_id": [3, 8]}
    segments = {"segments": ("pelvis", "thigh", "shank", "foot"), "world_from_segment": pose}
    angles = joint_angles(rng.normal(size=(5, 2, 3, 3)), joints=("hip", "knee", "ankle"), **people, **segments)
    xyz, seen = rng.normal(size=(5, 2, 23, 3)), {"views": tuple(views), "joints": angles if joints else None}
    return Truth(**people, **seen, rig=rig, skeleton=ANATOMICAL23, xyz_world=xyz)


@pytest.mark.parametrize("joints", [True, False])
def test_read_gives_what_was_written(tmp_path: Path, ring_rig, joints: bool):
    truth = _truth(ring_rig, joints)
    write_truth(tmp_path / "truth.npz", truth)
    back = read_truth(tmp_path / "truth.npz")
    assert (back.rig.id, back.rig.world_set_by) == (truth.rig.id, truth.rig.world_set_by)
    assert_same(replace(back, rig=truth.rig), truth, atol=1e-15)


def test_same_values_same_bytes(tmp_path: Path, ring_rig):
    for name in ("a.npz", "b.npz"):
        write_truth(tmp_path / name, _truth(ring_rig))
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_other_files_are_refused_by_name(tmp_path: Path, ring_rig):
    refusal(InputError, "nowhere", write_truth, tmp_path / "nowhere" / "truth.npz", _truth(ring_rig))
    (tmp_path / "text.npz").write_text("no archive")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    for name in ("text.npz", "other.npz", "missing.npz"):
        refusal(InputError, name, read_truth, tmp_path / name)
