"""A man on a beam, a bystander, swapped sides: OpenPose's detections, associated and fused, against another pipeline."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import built
import numpy as np
import pytest

from posefuse.association import AssociateSettings, associate
from posefuse.cli.main import main
from posefuse.core import SKELETONS, Detections2D, PoseSequence, Rig, Views
from posefuse.evaluation.tracks import read_tracks
from posefuse.formats.recording import read_recording
from posefuse.formats.rig import read_rig, write_rig
from posefuse.fusion import FuseSettings, Weights, fuse
from posefuse.tracking import SmoothSettings, smooth

BODY = SKELETONS["body_25b"]
FRAMES = 100


@pytest.fixture(scope="module")
def reference(shared_data: Path) -> tuple[list[str], np.ndarray]:
    """Keypoint names and (T, K, 3) world metres."""
    tracks = read_tracks(shared_data / "pose2sim_single" / "reference" / "S00_P00_T01_BalancingTrial_0-100.trc")
    # what the file itself has: the middle of the hips is made of its points
    names = [name for name in tracks.points if name != "mid_hip"]
    return names, tracks.xyz_m[:, [tracks.points.index(name) for name in names]]


@pytest.fixture(scope="module")
def rig(shared_data: Path) -> Rig:
    """cam_01 and cam_02 deliver 1080 of the 1088 columns they were calibrated with: the last 8 are cut off."""
    return read_rig(shared_data / "pose2sim_single" / "calibration" / "Calib_qualisys.toml")


@pytest.fixture(scope="module")
def detections(shared_data: Path, rig: Rig) -> list[list[Detections2D]]:
    """Everybody OpenPose saw: one or two people per camera, three at times."""
    time_steps = []
    for i in range(FRAMES):
        cameras = []
        for name in rig.names:
            file = name.replace("_", "")
            path = shared_data / "pose2sim_single" / "openpose_json" / f"{file}_json" / f"{file}.{i:04d}.json"
            people = np.array([p["pose_keypoints_2d"] for p in json.loads(path.read_text())["people"]]).reshape(-1, 25, 3)
            xy = np.where(people[..., 2:] > 0, people[..., :2], np.nan)
            cameras.append(built.detections(name, xy, i * 16_666_667, score=people[..., 2], sigma_px=np.nan, skeleton=BODY))
        time_steps.append(cameras)
    return time_steps


@pytest.fixture(scope="module")
def man(detections: list[list[Detections2D]], rig: Rig) -> list[Views]:
    """The one person followed, from nothing but the detections."""
    time_steps: list[Views] = []
    previous = None
    for seen in detections:
        time_steps.append(associate(seen, rig, AssociateSettings(), previous))
        previous = fuse(time_steps[-1], rig, FuseSettings(), previous)
    return time_steps


@pytest.fixture(scope="module")
def fused(man: list[Views], rig: Rig) -> Callable[[Weights], PoseSequence]:
    return lambda weights: PoseSequence.from_poses([fuse(views, rig, FuseSettings(weights=weights)) for views in man])


def test_association_picks_the_man_in_every_view_of_every_frame(detections, man, rig, reference):
    names, xyz = reference
    columns = BODY.indices(names)
    crowded = 0
    for i, (seen, views) in enumerate(zip(detections, man, strict=True)):
        assert views.person_id.tolist() == [0]
        expected = rig.project(xyz[i])
        for c, report in enumerate(seen):
            # in one frame he is in two pieces: either is him
            miss = np.nanmedian(np.linalg.norm(report.xy_img[:, columns] - expected[c], axis=-1), axis=1)
            his = [np.array_equal(views.xy_img[0, c], xy, equal_nan=True) for xy in report.xy_img[miss < 50]]
            assert any(his)
            crowded += bool((miss > 200).any())
    assert crowded > 100


def test_score_weights_agree_with_the_reference(fused, reference):
    """The reference is a confidence-weighted DLT as well; where it left cameras out (hips, knees) it differs."""
    names, xyz = reference
    apart = np.linalg.norm(fused("score").xyz_world[:, 0, BODY.indices(names)] - xyz, axis=-1)
    assert np.nanmedian(apart) < 0.003
    assert np.isnan(apart).sum() < 10


def test_robust_never_jumps_where_the_reference_does_not_nor_does_any_weighting_smoothed(fused, reference):
    names, xyz = reference
    expected = np.linalg.norm(np.diff(xyz, axis=0), axis=-1)
    smoothed = [smooth(fused(weights), SmoothSettings()) for weights in ("score", "robust")]
    assert all(np.isfinite(poses.xyz_world[:, 0, BODY.indices(names)]).all() for poses in smoothed)
    for poses in (fused("robust"), *smoothed):
        steps = np.linalg.norm(np.diff(poses.xyz_world[:, 0, BODY.indices(names)], axis=0), axis=-1)
        assert not ((steps > 0.15) & (expected < 0.15)).any()


def test_robust_is_steadier_and_holds_bones_better_than_the_reference(fused, reference):
    names, xyz = reference
    ours = fused("robust").xyz_world[:, 0, BODY.indices(names)]
    bones = [(names.index(a), names.index(b)) for a, b in BODY.bones if a in names and b in names]

    def jitter(points: np.ndarray) -> float:
        return float(np.sqrt(np.nanmean(np.diff(points, 2, axis=0) ** 2)))

    def looseness(points: np.ndarray) -> float:
        return float(np.mean([np.nanstd(np.linalg.norm(points[:, a] - points[:, b], axis=-1)) for a, b in bones]))

    assert jitter(ours) < 0.6 * jitter(xyz)
    assert looseness(ours) < 0.8 * looseness(xyz)


@pytest.mark.parametrize(("degrees", "code"), [(0.0, 0), (3.0, 1)])
def test_a_camera_turned_by_3_deg_is_named_on_footage_of_1_7_s(
    shared_data: Path, rig: Rig, tmp_path: Path, capfd: pytest.CaptureFixture[str], degrees: float, code: int
) -> None:
    session = tmp_path / "session"
    session.mkdir()
    write_rig(session / "rig.toml", built.turned(rig, 2, [np.deg2rad(degrees), 0.0, 0.0]))
    shutil.copytree(shared_data / "pose2sim_single" / "openpose_json", session / "pose")
    assert main(["track", str(session), "--rate", "60", "--outputs", "trc", "--out", str(tmp_path / "result")]) == code
    said = capfd.readouterr().err
    assert ("cam_03 is off by" in said) == bool(degrees)
    about = read_recording(tmp_path / "result").provenance
    assert len(about["rig_warnings"]) == code
    assert about["camera_fits"]["cam_03"]["left_out"] == pytest.approx(degrees / 3, abs=0.05)
