"""The result folder and the truth file give every bit back, and say what is wrong with one that cannot be."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import built
import numpy as np
import pytest
from built import joint_angles
from checks import assert_same, refusal

from posefuse.core import SE3, CameraTruth, InputError, Recording, Rig, Skeleton, Truth
from posefuse.core.skeleton import ANATOMICAL23
from posefuse.formats.recording import read_recording, write_recording
from posefuse.formats.rig import write_rig
from posefuse.formats.truth import read_truth
from posefuse_sim.files import write_truth

SKELETON = Skeleton("three", ("left_hip", "right_hip", "nose"), (("left_hip", "right_hip"),))


@pytest.fixture
def recording(ring_rig: Callable[..., Rig]) -> Recording:
    rng = np.random.default_rng(0)
    T, N, C, K = 5, 2, 4, 3
    xyz = rng.normal(size=(T, N, K, 3))
    xyz[1, 0, 2] = np.nan
    whole = {name: rng.integers(0, 5, (T, N, K)) for name in ("n_views", "kind")}
    t_ns = np.array([0, 10, 25, 30, 44]) * 1_000_003
    poses = built.poses(xyz, skeleton=SKELETON, cov=rng.normal(size=(T, N, K, 3, 3)), t_ns=t_ns, ids=[3, 7], **whole)
    views = rng.normal(size=(T, N, C, K, 2)), rng.uniform(size=(T, N, C, K)), rng.uniform(size=(T, N, C, K))
    about = {"version": "0.1.0", "config": {"fuse": {"weights": "all"}}, "note": "ü"}
    # of a refused calibration, in the map of a robot, whose origin is at the gate
    rig = replace(ring_rig(C).moved(SE3([1.0, 0, 0, 0], [2500.0, -800.0, 3.0])), refused="corners fit")
    return built.recording_from_views(rig, poses, *views, about)


def test_depth_comes_back_in_a_format_of_its_own(tmp_path: Path, recording: Recording) -> None:
    depth = np.random.default_rng(2).uniform(1, 5, (*recording.observations.score.shape, 2)).astype(np.float32)
    depth[::3] = np.nan
    deep = replace(recording, observations=replace(recording.observations, depth_m=depth))
    folders = tmp_path / "deep", tmp_path / "plain"
    for folder, one in zip(folders, (deep, recording), strict=True):
        folder.mkdir()
        write_recording(folder, one)
    back, plain = (read_recording(folder).observations for folder in folders)
    np.testing.assert_array_equal(back.depth_m, depth)
    assert plain.depth_m is None
    versions = [json.loads((folder / "recording.json").read_text())["format_version"] for folder in folders]
    assert versions == [4, 3]
    np.testing.assert_array_equal(deep.views.depth_m[2, 1, 3], depth[deep.observations.detection_frame == 2 * 4 + 3][1])


def test_every_bit_comes_back(tmp_path: Path, recording: Recording) -> None:
    made = write_recording(tmp_path, recording)
    assert sorted(path.name for path in made) == sorted(path.name for path in tmp_path.iterdir())
    assert_same(read_recording(tmp_path), recording)


def test_folders_that_are_no_result(tmp_path: Path, recording: Recording, ring_rig: Callable[..., Rig]) -> None:
    refusal(InputError, r"not a posefuse result: there is no recording\.json", read_recording, tmp_path)
    write_recording(tmp_path, recording)
    written = (tmp_path / "recording.json").read_text()
    about = json.loads(written)
    for changed, words in (
        (about | {"format_version": 5}, "format version: expected 3 or 4, got 5"),
        (about | {"format_version": 4}, "the result is incomplete: 'depth_m' is missing"),
        (about | {"format_version": 2}, "got 2; an older posefuse wrote it: track the session again"),
        ({"a": 1}, "not a posefuse result"),
        ({key: value for key, value in about.items() if key != "rig_id"}, "rig_id is missing"),
        (about | {"skeleton": about["skeleton"] | {"keypoints": ["a"], "bones": []}}, "does not fit together"),
        (about | {"skeleton": {"name": "three"}}, "incomplete"),
    ):
        (tmp_path / "recording.json").write_text(json.dumps(changed))
        refusal(InputError, words, read_recording, tmp_path)
    (tmp_path / "recording.json").write_text("{")
    refusal(InputError, "cannot be parsed as JSON", read_recording, tmp_path)
    (tmp_path / "recording.json").write_text(written)
    assert read_recording(tmp_path).rig.id == recording.rig.id
    write_rig(tmp_path / "rig.toml", ring_rig(4, radius_m=3.0))
    refusal(InputError, r"rig\.toml is rig .*, the result was made with rig", read_recording, tmp_path)
    write_rig(tmp_path / "rig.toml", recording.rig)
    (tmp_path / "recording.npz").write_bytes(b"PK broken")
    refusal(InputError, r"recording\.npz: not an .npz file", read_recording, tmp_path)


def test_provenance_must_be_plain(tmp_path: Path, recording: Recording) -> None:
    with pytest.raises(InputError, match="provenance: expected plain JSON values"):
        write_recording(tmp_path, replace(recording, provenance={"path": tmp_path}))
    assert not list(tmp_path.iterdir())


# --- the truth file: what is written is read, byte for byte the same for the same values


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
