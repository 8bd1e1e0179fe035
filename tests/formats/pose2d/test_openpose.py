"""OpenPose folders: orders distinguished, missing stays missing, one clear error for what is broken."""

import json
import warnings

import numpy as np
import pytest
from checks import refusal
from studies import write_openpose

from posefuse.core import SKELETONS, InputError
from posefuse.formats.pose2d import read_openpose_folder, read_pose2d_of_cameras


def person(skeleton_name: str, seed: int = 0) -> np.ndarray:
    """(K, 3) a person standing, in the order of a skeleton."""
    skeleton = SKELETONS[skeleton_name]
    heights = {
        "ankle": 400, "heel": 410, "toe": 410, "knee": 320, "hip": 230, "wrist": 240, "elbow": 170, "shoulder": 100, "neck": 90,
    }  # fmt: skip
    rng = np.random.default_rng(seed)
    rows = []
    for name in skeleton.keypoints:
        across = {"left": 40, "right": -40}.get(name.split("_")[0], 0) * (2.5 if "wrist" in name or "elbow" in name else 1)
        height = next((value for part, value in heights.items() if part in name), 40)
        rows.append([300 + across, height, 0.8])
    return np.array(rows) + rng.normal(0, 1, (len(rows), 3)) * [2, 2, 0.01]


def write(folder, number, people):
    write_openpose(folder, {number: np.array(people) if people else np.zeros((0, 25, 3))})


@pytest.mark.parametrize("name", ["body_25", "body_25b", "coco17"])
def test_the_order_is_reported_from_the_people(tmp_path, name):
    write(tmp_path, 0, [])
    write(tmp_path, 1, [person(name), person(name, 1)])
    folder = read_openpose_folder(tmp_path, "cam1")
    assert folder.skeleton.name == name and len(folder) == 2
    no_person, two = folder.frames(rate_hz=50)
    assert len(no_person) == 0 and len(two) == 2
    assert two.t_ns == 20_000_000 and two.camera == "cam1"
    assert np.allclose(two.xy_img[1], person(name, 1)[:, :2], atol=1e-3)
    assert (two.box_img[0, :2] <= two.xy_img[0].min(0)).all()


@pytest.mark.parametrize("name", ["body_25", "body_25b"])
def test_a_walker_from_the_side_and_a_camera_without_hips_are_read_as_the_others(tmp_path, name):
    """In the image hips seen from the side are at one place, wherever the legs are; one camera shows no hip at all."""
    side, above = tmp_path / "side", tmp_path / "above"
    hips = [SKELETONS[name].index(part) for part in ("left_hip", "right_hip") if part in SKELETONS[name].keypoints]
    for k in range(8):
        flat = person(name, k)
        flat[:, 0] = 300 + 0.15 * (flat[:, 0] - 300) + np.random.default_rng(k).normal(0, 6, len(flat))
        write(side, k, [flat])
        upper = person(name, k)
        upper[hips, 2] = 0
        write(above, k, [upper])
    both = read_pose2d_of_cameras({"side": side, "above": above})
    assert [one.skeleton.name for one in both] == [name, name]
    assert read_openpose_folder(side, "side").skeleton.name == name
    other = "body_25" if name == "body_25b" else "body_25b"
    stated = read_pose2d_of_cameras({"side": side}, other)
    assert stated[0].skeleton.name == other
    refusal(InputError, r"keypoints: no set 'body25'; there are: .*body_25b", read_pose2d_of_cameras, {"side": side}, "body25")


def test_a_keypoint_of_score_0_is_missing_and_noise_grows_as_the_score_falls(tmp_path):
    points = person("body_25")
    points[4] = 0
    points[5, 2], points[6, 2] = 0.9, 0.3
    write(tmp_path, 0, [points, np.zeros((25, 3))])
    seen = read_openpose_folder(tmp_path, "cam1").frame(0, 0)
    assert len(seen) == 1
    assert np.isnan(seen.xy_img[0, 4]).all() and seen.score[0, 4] == 0 and np.isnan(seen.sigma_px[0, 4])
    assert seen.sigma_px[0, 6] == pytest.approx(3 * seen.sigma_px[0, 5], rel=1e-4)


def test_broken_files_are_named(tmp_path):
    good = tmp_path / "good"
    write(good, 0, [person("body_25")])
    (good / "cam_000000000001_keypoints.json").write_text('{"people": [')
    folder = read_openpose_folder(good, "cam1", SKELETONS["body_25"])
    refusal(InputError, r"000000000001_keypoints\.json: cannot be parsed as JSON", folder.frame, 1, 0)
    (good / "cam_000000000001_keypoints.json").write_text('{"persons": []}')
    refusal(InputError, "expected people", folder.frame, 1, 0)
    write(good, 1, [person("coco17")])
    refusal(InputError, r"expected 25 keypoints \(body_25\), got a person with 17", folder.frame, 1, 0)


def test_huge_numbers_are_one_line_without_warnings(tmp_path):
    """10^400 is more than a float holds."""
    people = [{"pose_keypoints_2d": [10**400, 5, 0.9] * 25}]
    (tmp_path / "cam_000000000000_keypoints.json").write_text(json.dumps({"people": people}))
    with warnings.catch_warnings(), pytest.raises(InputError, match=r"expected keypoints within 1e\+06 px of the image, got inf"):
        warnings.simplefilter("error")
        read_openpose_folder(tmp_path, "cam")


def test_more_people_than_an_image_can_show_are_refused(tmp_path):
    people = [{"pose_keypoints_2d": [1.0, 5.0, 0.9] * 17}] * 1001
    (tmp_path / "cam_000000000000_keypoints.json").write_text(json.dumps({"people": people}))
    frames = read_openpose_folder(tmp_path, "cam")
    refusal(InputError, "2D poses of frame 0: expected at most 1000 people, got 1001", frames.frame, 0, 0)


def test_folders_that_cannot_be_are_named(tmp_path):
    refusal(InputError, "no such folder", read_openpose_folder, tmp_path / "nowhere", "cam1")
    refusal(InputError, r"expected one \.json per frame", read_openpose_folder, tmp_path, "cam1")
    write(tmp_path / "empty", 0, [])
    refusal(InputError, "camera cam1: no person", read_openpose_folder, tmp_path / "empty", "cam1")
    assert len(read_openpose_folder(tmp_path / "empty", "cam1", SKELETONS["body_25"]).frame(0, 0)) == 0
    write(tmp_path / "odd", 0, [np.ones((21, 3))])
    refusal(InputError, "keypoints, got 21", read_openpose_folder, tmp_path / "odd", "cam1")
    write(tmp_path / "twice", 0, [person("body_25")])
    (tmp_path / "twice" / "x_0.json").write_text('{"people": []}')
    refusal(InputError, "same frame number 0", read_openpose_folder, tmp_path / "twice", "cam1")


def test_real_files(shared_data):
    folder = read_openpose_folder(shared_data / "pose2sim_single" / "openpose_json" / "cam01_json", "cam01")
    assert folder.skeleton.name == "body_25b" and len(folder) == 100
    seen = list(folder.frames(60))
    assert sum(len(one) > 0 for one in seen) >= 98
    assert max(len(one) for one in seen) >= 2
