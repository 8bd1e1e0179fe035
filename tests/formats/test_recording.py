"""The result folder gives every bit back, and says what is wrong with one that cannot be."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import built
import numpy as np
import pytest
from checks import assert_same, refusal

from posefuse.core import SE3, InputError, Recording, Rig, Skeleton
from posefuse.formats.recording import read_recording, write_recording
from posefuse.formats.rig import write_rig

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
