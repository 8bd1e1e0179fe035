"""The biomechanist's files: all written, each readable by an independent reader, people and gaps handled."""

import csv
import dataclasses
import sys

import built
import ezc3d
import numpy as np
import pytest
from checks import refusal
from figure import sequence_of
from motions import columns_of, read_bvh

from bench.angle_errors import angle_errors, joints_from_lab, poses_from_lab
from posefuse.core import DependencyError, InputError, Recording, Skeleton
from posefuse.core.observations import LIVE_STEP
from posefuse.evaluation.biomechanics import BiomechanicsSettings, joints_of, write_biomechanics
from posefuse.formats.c3d import C3dData, write_c3d
from posefuse.kinematics import joints_from_poses


@pytest.fixture
def recording(ring_rig):
    frames = [{"left_knee": (40 + i, 0, 0), "left_hip": (20, 3, 4), "right_knee": (30, 0, 0)} for i in range(24)]
    sequence = sequence_of(frames, "anatomical23", sigma_m=0.004, rate_hz=30.0)
    return built.recording(ring_rig(3), sequence, score=1.0)


def with_points_of(recording, *parts):
    """The recording as a network would give it that marks these parts of both sides only."""
    names = tuple(f"{side}_{part}" for part in parts for side in ("left", "right"))
    kept = [recording.poses.skeleton.index(name) for name in names]
    few = built.arrays_of(recording.poses, lambda one: one[:, :, kept])
    poses = dataclasses.replace(recording.poses, skeleton=Skeleton("few", names, ()), **few)
    return built.recording(recording.rig, poses, score=1.0)


LEGS = ("hip", "knee", "ankle", "heel", "big_toe")


@pytest.mark.parametrize("fit", ["none", "points"])
@pytest.mark.parametrize("parts", [("shoulder", *LEGS[:3]), ("shoulder", *LEGS), LEGS, LEGS[:3]], ids=len)
def test_the_joints_whose_points_exist_are_computed_and_the_rest_is_listed(recording, tmp_path, fit, parts):
    """Networks for gait mark the legs: no elbow, hand or face, and some no shoulder."""
    said = []
    few = with_points_of(recording, *parts)
    chosen = BiomechanicsSettings(fit=fit)
    made = write_biomechanics(few, tmp_path, chosen, progress=lambda stage, done, total, line="": said.append(line))
    assert {"angles.csv", "angles.mot", "points_angles.c3d", "report.html"} <= {path.name for path in made}
    _, joints = joints_of(few, chosen)
    knee = np.degrees(joints.angle_rad[:, 0, joints.joints.index("left_knee"), 0])
    np.testing.assert_allclose(knee, 40 + np.arange(24), atol=1.0)
    known = {joint for j, joint in enumerate(joints.joints) if np.isfinite(joints.angle_rad[:, 0, j]).any()}
    assert ("left_ankle" in known) == ("heel" in parts) and ("left_hip" in known) == ("shoulder" in parts)
    [line] = [line for line in said if line.startswith("no angles of ")]
    assert "neck" in line and "left_elbow" in line and ": few has no " in line
    assert ("pelvis" in line) == ("shoulder" not in parts)


@pytest.mark.parametrize("fit", ["none", "points"])
def test_every_file_has_the_same_values(recording, tmp_path, fit):
    chosen = BiomechanicsSettings(fit=fit)
    made = write_biomechanics(recording, tmp_path, chosen)
    assert {path.name for path in made} == {path.name for path in tmp_path.iterdir()}
    _, joints = joints_of(recording, chosen)
    knee = np.degrees(joints.angle_rad[:, 0, joints.joints.index("left_knee"), 0])
    np.testing.assert_allclose(knee, 40 + np.arange(24), atol=1.0)
    with (tmp_path / "angles.csv").open(encoding="utf-8", newline="") as file:
        written = [float(row["left_knee.flexion_deg"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(written, knee, atol=5.1e-5)
    np.testing.assert_allclose(columns_of(tmp_path / "angles.mot")["knee_angle_l"], knee, rtol=1e-8)
    assert len(read_bvh(tmp_path / "skeleton.bvh")) == 24
    assert "Knee flexion" in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("fit", ["none", "points"])
def test_a_live_session_that_skipped_output_ticks_has_all_files_with_its_times(recording, tmp_path, fit):
    import ezc3d

    kept = np.delete(np.arange(24), [5, 11, 12])
    poses, seen = recording.poses, recording.observations
    fewer = dataclasses.replace(poses, t_ns=poses.t_ns[kept], **built.arrays_of(poses, lambda one: one[kept]))
    logged = dataclasses.replace(seen, step_t_ns=np.zeros(0, np.int64), frame_step=np.full(len(seen.frame_step), LIVE_STEP))
    write_biomechanics(Recording(rig=recording.rig, poses=fewer, observations=logged), tmp_path, BiomechanicsSettings(fit=fit))
    points = ezc3d.c3d(str(tmp_path / "points_angles.c3d"))["data"]["points"][:3, poses.skeleton.index("left_knee")].T
    assert len(points) == 24 and len(read_bvh(tmp_path / "skeleton.bvh")) == 24 and (tmp_path / "skeleton.glb").is_file()
    np.testing.assert_allclose(points[kept], 1000 * poses.xyz_world[kept, 0, poses.skeleton.index("left_knee")], atol=20.0)
    motion = columns_of(tmp_path / "angles.mot")
    np.testing.assert_allclose(motion["knee_angle_l"], 40 + np.interp(motion["time"], poses.t_ns * 1e-9, np.arange(24)), atol=1.0)


def test_files_of_a_rate_are_left_out_where_the_times_have_none(recording, tmp_path):
    poses, seen = recording.poses, recording.observations
    t_ns = poses.t_ns + 7_000_000 * (np.arange(24) % 2)
    there = dataclasses.replace(poses, t_ns=t_ns)
    uneven = Recording(rig=recording.rig, poses=there, observations=dataclasses.replace(seen, step_t_ns=t_ns))
    said = []
    made = write_biomechanics(
        uneven, tmp_path, BiomechanicsSettings(fit="none"), progress=lambda stage, done, total, line="": said.append(line)
    )
    assert {path.name for path in made} == {"angles.csv", "angles.mot", "report.html"} == {one.name for one in tmp_path.iterdir()}
    [line] = [line for line in said if "evenly spaced" in line]
    assert line.startswith("no points_angles.c3d, skeleton.bvh and .glb: ")


def test_ezc3d_finds_points_and_angles(recording, tmp_path):
    write_biomechanics(recording, tmp_path, BiomechanicsSettings(fit="none"))
    file = ezc3d.c3d(str(tmp_path / "points_angles.c3d"))
    labels = file["parameters"]["POINT"]["LABELS"]["value"]
    joints = joints_from_poses(recording.poses)
    assert "left_knee_angles" in file["parameters"]["POINT"]["ANGLES"]["value"]
    stored = file["data"]["points"][0, labels.index("left_knee_angles")]
    hip = file["data"]["points"][:3, labels.index("left_hip")].T
    np.testing.assert_allclose(hip, recording.poses.xyz_world[:, 0, recording.poses.skeleton.index("left_hip")] * 1000, atol=1e-3)
    knee = joints.angle_rad[:, 0, joints.joints.index("left_hip")]
    np.testing.assert_allclose(file["data"]["points"][:3, labels.index("left_hip_angles")].T, np.degrees(knee), atol=1e-3)
    np.testing.assert_allclose(stored, 40 + np.arange(24), atol=1.0)
    assert "left_wrist_angles" not in labels


def test_several_people_have_files_of_their_own(recording, tmp_path):
    poses = recording.poses
    two = built.arrays_of(poses, lambda one: np.concatenate([one] * 2, axis=1))
    two["xyz_world"][:, 1] = np.nan
    both = built.recording(recording.rig, dataclasses.replace(poses, person_id=[2, 7], **two), score=1.0)
    made = write_biomechanics(both, tmp_path, BiomechanicsSettings(fit="points"))
    names = {path.name for path in made}
    assert {"angles_person2.mot", "skeleton_person2.bvh"} <= names
    assert not any("_7" in name for name in names)
    assert "Not seen in any time step" in (tmp_path / "report.html").read_text()


def test_a_missing_opensim_is_named_and_leaves_no_folder(recording, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "opensim", None)
    chosen = BiomechanicsSettings(fit="none", opensim_model=tmp_path / "my.osim")
    refusal(DependencyError, "biomech", write_biomechanics, recording, tmp_path, chosen)
    assert not (tmp_path / "opensim").exists()


def test_one_time_step_has_angles_and_no_animation(recording, tmp_path):
    poses = recording.poses
    first = dataclasses.replace(poses, t_ns=poses.t_ns[:1], **built.arrays_of(poses, lambda one: one[:1]))
    seen = built.recording(recording.rig, first, score=1.0)
    made = write_biomechanics(seen, tmp_path, BiomechanicsSettings(fit="none"))
    assert {path.suffix for path in made} == {".csv", ".mot", ".c3d", ".html"}


def test_a_person_without_skeleton_files_is_named_with_the_reason(recording, tmp_path):
    said = []
    away = built.unseen(recording.poses, *recording.poses.skeleton.keypoints, steps=slice(3, 21))
    gone, chosen = dataclasses.replace(recording, poses=away), BiomechanicsSettings(fit="none")
    made = write_biomechanics(gone, tmp_path, chosen, progress=lambda stage, done, total, line="": said.append(line))
    assert not [path for path in made if path.suffix in (".bvh", ".glb")]
    assert any("no skeleton.bvh and .glb: segment pelvis is missing from 0.07 to 0.70 s" in line for line in said)


def test_stages_are_reported_as_they_begin(recording, tmp_path):
    reported = []
    report = lambda *report: reported.append(report)  # noqa: E731
    write_biomechanics(recording, tmp_path, BiomechanicsSettings(fit="points"), title="Trial 7", progress=report)
    assert [one[:3] for one in reported] == [("report", done, 3) for done in (0, 1, 1, 2, 3)]
    assert "fitted to the points" in reported[0][3] and "no angles of left_wrist, right_wrist: " in reported[1][3]
    assert "<h1>Trial 7</h1>" in (tmp_path / "report.html").read_text()


# --- angle errors, and our angles against a gait laboratory's own


def made_joints(angle_rad, names=("left_knee", "neck"), step_ns=10_000_000):
    kinds = (("flexion", "adduction", "internal_rotation"),) * len(names)
    t_ns, sigma_rad = np.arange(len(angle_rad)) * step_ns, np.full(angle_rad.shape, np.radians(2.0))
    return built.joint_angles(angle_rad, joints=names, t_ns=t_ns, angle_names=kinds, sigma_rad=sigma_rad)


def test_bias_spread_and_rmse_over_whole_turns_and_gaps():
    truth = np.random.default_rng(0).normal(size=(50, 1, 2, 3))
    estimate = truth + np.radians(3.0) + np.radians(4.0) * np.where(np.arange(50) % 2, 1, -1)[:, None, None, None] + 2 * np.pi
    estimate[:10, :, 0, 0] = np.nan
    rows = {(e.joint, e.angle): e for e in angle_errors(made_joints(estimate), made_joints(truth))}
    knee = rows["left_knee", "flexion"]
    assert (knee.bias_deg, knee.sd_deg, knee.rmse_deg) == pytest.approx((3, 4, 5))
    assert knee.defined == pytest.approx(0.8)
    assert knee.stated_deg == pytest.approx(2)
    assert len(rows) == 6


def test_time_steps_are_matched_by_time():
    truth = np.broadcast_to(np.arange(100.0)[:, None, None, None] * 0.01, (100, 1, 2, 3))
    every_second = made_joints(truth[::2], step_ns=20_000_000)
    assert angle_errors(every_second, made_joints(truth))[0].rmse_deg == pytest.approx(0, abs=1e-9)
    later = dataclasses.replace(every_second, t_ns=every_second.t_ns + 10**12)
    refusal(InputError, "no time step in common", lambda: angle_errors(later, made_joints(truth)))


def test_other_joints_and_people_are_refused():
    angle = np.zeros((5, 1, 2, 3))
    with pytest.raises(InputError, match="no angle in common; the reference has jaw, tail"):
        angle_errors(made_joints(angle), made_joints(angle, ("jaw", "tail")))
    with pytest.raises(InputError, match="expected 1 people as in the reference, got 2"):
        angle_errors(made_joints(np.zeros((5, 2, 2, 3))), made_joints(angle))


def test_flexion_agrees_with_a_gait_laboratory(shared_data):
    path = shared_data / "btk" / "FunctionalWalk.c3d"
    rows = {(e.joint, e.angle): e for e in angle_errors(joints_from_poses(poses_from_lab(path)), joints_from_lab(path))}
    for side in ("left", "right"):
        assert rows[f"{side}_knee", "flexion"].sd_deg < 0.5
        assert abs(rows[f"{side}_knee", "flexion"].bias_deg) < 1.0
        assert rows[f"{side}_hip", "flexion"].rmse_deg < 0.1
        assert rows[f"{side}_hip", "adduction"].rmse_deg < 0.1
        assert rows[f"{side}_ankle", "dorsiflexion"].sd_deg < 2.5


def test_a_file_without_the_points_is_refused_with_a_list_of_its_points(tmp_path):
    data = C3dData(names=("RKNE", "LKNE"), xyz_world=np.zeros((4, 2, 3)), sigma_m=np.zeros((4, 2)), rate_hz=100.0)
    write_c3d(tmp_path / "a.c3d", data)
    refusal(InputError, r"no point PELP; there are: RKNE, LKNE", poses_from_lab, tmp_path / "a.c3d")
    refusal(InputError, "no angles LHipAngles", joints_from_lab, tmp_path / "a.c3d")
