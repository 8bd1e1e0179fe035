"""Rigs that cannot be right end in one line that names file, camera and fault; each change below is refused on its own."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from checks import refusal

from posefuse.core import SE3, CalibrationError, Rig
from posefuse.formats.rig import read_rig, rig_warnings, write_rig
from posefuse_sim.cameras import looking_at

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "files"
MIRROR = [[1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]]
BENT = [[1.0, 0.01, 0], [0, 1.0, 0], [0, 0, 1.0]]


@pytest.fixture
def rig_file(tmp_path: Path, ring_rig: Callable[..., Rig]) -> Callable[..., Path]:
    """A good file in which one piece of text is replaced: our own, or a golden file of another format."""

    def make(name: str, old: str, new: str) -> Path:
        path = tmp_path / name
        if name == "rig.toml":
            write_rig(path, ring_rig(3, distortion=(0.1, -0.05, 0.001, 0.002)))
        else:
            shutil.copyfile(GOLDEN / name, path)
        read_rig(path)
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))
        return path

    return make


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("size = [640, 480]", "", r"camera cam00: size is missing; there are: name, matrix"),
        ("size = [640, 480]", "size = [640.5, 480]", r"camera cam00: size: expected whole px, got 640.5 x 480"),
        ("size = [640, 480]", "size = [640]", r"camera cam00: size: expected 2 numbers, got shape \(1,\)"),
        ("size = [640, 480]", "size = [0, 480]", r"camera cam00: expected an image size of at least 1x1 px, got 0x480"),
        ("576.0", "nan", r"camera cam00: matrix: expected finite numbers, got NaN"),
        ("576.0", "-576.0", r"camera cam00: K: expected .* fx, fy > 0"),
        ("576.0", '"a"', r"camera cam00: matrix: expected numbers"),
        ("[0.0, 0.0, 1.0]]", "[0.0, 0.0]]", r"camera cam00: matrix: expected numbers"),
        ("distortions = [0.1, ", "distortions = [", r"distortion \(pinhole\): expected 0, 4, 5, 8, 12, 14 coefficients, got 3"),
        ("fisheye = false", "fisheye = 7", r"camera cam00: fisheye: expected true or false, got 7"),
        ("fisheye = false", "readout_s = -1", r"camera cam00: readout_s: expected >= 0 s, got -1"),
        ("rotation = [", "rotation = [0.0, ", r"camera cam00: rotation: expected a 3x3 matrix or 3 numbers"),
        ("[cam01]\nname = \"cam01\"", "[cam01]\nname = \"cam00\"", r"names must be unique, got twice: cam00"),
        ("[cam00]", "[cam00", r"cannot be parsed"),
        ("translation = [", "translation = [4500.0, 0.0, 2000.0]\nold = [", r"got a camera 49\d\d m .* looks like millimetres"),
    ],
)  # fmt: skip
def test_toml(rig_file: Callable[..., Path], old: str, new: str, message: str) -> None:
    path = rig_file("rig.toml", old, new)
    line = refusal(CalibrationError, message, read_rig, path)
    assert str(path) in line


@pytest.mark.parametrize(("matrix", "message"), [(MIRROR, "mirrored"), (BENT, "not a rotation matrix"), (np.eye(4), "got shape")])
def test_matrices_that_are_no_rotation(tmp_path: Path, ring_rig: Callable[..., Rig], matrix: list, message: str) -> None:
    content = json.loads((GOLDEN / "rig.json").read_text())
    for good in (np.eye(3), np.round(ring_rig(1).cameras[0].cam_from_world.matrix(), 5)):
        content["cam_0"]["R"] = good.tolist()
        (tmp_path / "rig.json").write_text(json.dumps(content))
        got = read_rig(tmp_path / "rig.json").cameras[0].cam_from_world.matrix()
        np.testing.assert_allclose(got, good, atol=2e-5)
        np.testing.assert_allclose(got @ got.T, np.eye(3), atol=1e-14)
    content["cam_0"]["R"] = np.asarray(matrix).tolist()
    (tmp_path / "rig.json").write_text(json.dumps(content))
    refusal(CalibrationError, rf"camera cam_0: rotation: .*{message}", read_rig, tmp_path / "rig.json")


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("rig.qca.txt", 'focalLengthU="', 'old="', r"camera cam_0: <intrinsic>: focalLengthU is missing"),
        ("rig.qca.txt", "<transform", "<other", r"camera cam_0: <transform> is missing; there are: fov_marker"),
        ("rig.qca.txt", ' r11="', ' r11="9" old="', r"camera cam_0: rotation: not a rotation"),
        ("rig.qca.txt", ' x="', ' x="nan" old="', r"camera cam_0: x: expected finite numbers"),
        ("rig.qca.txt", "</cameras>", "", r"cannot be parsed"),
        ("rig.yaml", "rows: 3", "rows: 4", r"matrix: expected rows x cols = 4 x 3 numbers in data, got 9"),
        ("rig.yaml", "image_width", "width_of_image", r"camera cam_0: image_width or width is missing"),
        ("rig.yaml", "R: !!opencv", "X: !!opencv", r"camera cam_0: R or rvec or .* is missing"),
        ("rig.yaml", "camera_matrix: ", "camera_matrix: }{ ", r"cannot be parsed"),
        (
            "camera_array.toml",
            "rotation = [[",
            "rotation = [[9.0, 0, 0], [0, 1, 0], [0, 0, 1]]\nold = [[",
            r"camera cam_0: rotation: not a rotation",
        ),
    ],
)
def test_other_formats(rig_file: Callable[..., Path], name: str, old: str, new: str, message: str) -> None:
    refusal(CalibrationError, message, lambda: read_rig(rig_file(name, old, new)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("tf:", "pose:", r"cam_0.yaml: camera cam_0: has no pose; .*TransformStamped"),
        ("plumb_bob", "pinecone", r"distortion_model: expected one of plumb_bob, .*, got 'pinecone'"),
        ("w: ", "w: 1", r"tf: rotation: expected a unit quaternion"),
        ("transform:", "nothing:", r"tf: expected transform with translation"),
    ],
)
def test_ros(tmp_path: Path, old: str, new: str, message: str) -> None:
    file = shutil.copytree(GOLDEN / "rig_ros", tmp_path / "info") / "cam_0.yaml"
    file.write_text(file.read_text().replace(old, new, 1))
    refusal(CalibrationError, message, read_rig, tmp_path / "info")


def test_files_that_are_no_rig(tmp_path: Path) -> None:
    refusal(CalibrationError, "no such calibration file", read_rig, tmp_path / "rig.toml")
    refusal(CalibrationError, "expected one calibration file per camera", read_rig, tmp_path)
    (tmp_path / "rig.toml").write_text("[metadata]\nerror = 1.0\n")
    refusal(CalibrationError, "expected at least 1 camera, got 0", read_rig, tmp_path / "rig.toml")
    (tmp_path / "notes.md").write_text("# hello")
    refusal(CalibrationError, r"known: caliscope .*; Anipose .*; Qualisys .*; ROS .*; OpenCV", read_rig, tmp_path / "notes.md")
    (tmp_path / "a.json").write_text("[1, 2]")
    refusal(CalibrationError, "known", read_rig, tmp_path / "a.json")
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    refusal(CalibrationError, "cannot be read as text", read_rig, tmp_path / "b.toml")
    (tmp_path / "x.txt").write_text('<!DOCTYPE c [<!ENTITY a "b">]><calibration/>')
    refusal(CalibrationError, "DOCTYPE", read_rig, tmp_path / "x.txt")


READINGS: dict[str, Callable[[SE3], SE3]] = {
    "the inverse of poses": lambda pose: pose.inverse(),
    "camera centres for t": lambda pose: SE3(pose.wxyz, pose.inverse().xyz),
    "transposed rotations": lambda pose: SE3.from_matrix(pose.matrix().T, pose.xyz),
}


@pytest.fixture
def room(ring_rig: Callable[..., Rig]) -> Rig:
    """Cameras in places as a laboratory has them: no two alike."""
    places = [((-3.2, -2.1, 2.4), (0.2, 0, 1)), ((3.9, -1.2, 1.7), (0, 0.3, 0.8)), ((2.2, 3.4, 2.6), (-0.3, 0, 1.1)),
              ((-2.4, 3.1, 1.2), (0.1, -0.2, 0.9)), ((0.4, -4.4, 2.0), (0, 0.2, 1.2))]  # fmt: skip
    poses = [looking_at(np.array(at), np.array(to)) for at, to in places]
    return Rig(tuple(replace(camera, cam_from_world=pose) for camera, pose in zip(ring_rig(5), poses, strict=True)))


@pytest.mark.parametrize("words", READINGS)
def test_poses_that_mean_something_else_are_named_before_tracking(words: str, room: Rig) -> None:
    rig, read = room, READINGS[words]
    assert rig_warnings("rig.toml", rig) == ()
    every = Rig(tuple(replace(camera, cam_from_world=read(camera.cam_from_world)) for camera in rig))
    assert any(f"would if the file held {words}" in line for line in rig_warnings("rig.toml", every))


@pytest.mark.parametrize(("words", "c"), [("the inverse of poses", 4), ("camera centres for t", 0)])
def test_one_camera_whose_pose_means_something_else_is_named(words: str, c: int, room: Rig) -> None:
    """Where it looks away from what the others see; else only `track` can notice it."""
    cameras, read = list(room.cameras), READINGS[words]
    cameras[c] = replace(cameras[c], cam_from_world=read(cameras[c].cam_from_world))
    [line] = rig_warnings("rig.toml", Rig(tuple(cameras)))
    assert line.startswith(f"rig.toml: cam0{c} sees nothing of what 4 others see together") and words in line


@pytest.mark.parametrize(
    ("turn", "axis"), [([np.pi / 2, 0, 0], "-Y"), ([-np.pi / 2, 0, 0], "Y"), ([np.pi, 0, 0], "-Z"), ([0, np.pi / 2, 0], "X")]
)
def test_a_world_that_does_not_stand_upright_is_named(turn: list[float], axis: str, ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(4).moved(SE3.from_rotvec(turn, np.zeros(3)))
    [line] = rig_warnings("rig.toml", rig)
    assert f"up in the images is {axis} of the world; expected Z" in line


def test_a_principal_point_outside_of_the_image_is_a_cropped_sensor_where_the_file_states_it(
    tmp_path: Path, ring_rig: Callable[..., Rig]
) -> None:
    cropped = ring_rig(2).cameras[0].cropped(350, 0, (200, 480))
    assert cropped.K[0, 2] < 0
    path = tmp_path / "rig.toml"
    write_rig(path, Rig((cropped,)))
    np.testing.assert_allclose(read_rig(path).cameras[0].K, cropped.K)
    path.write_text(path.read_text().replace("cropped = true\n", ""))
    refusal(CalibrationError, r"lies outside of the image of 200x480 px; .*state cropped = true", read_rig, path)
    text = (GOLDEN / "rig.qca.txt").read_text()
    (tmp_path / "lab.qca.txt").write_text(text.replace('<fov_video left="0"', '<fov_video left="700"'))
    shifted = read_rig(GOLDEN / "rig.qca.txt").cameras[0].K[0, 2] - 700
    assert shifted < 0 and read_rig(tmp_path / "lab.qca.txt").cameras[0].K[0, 2] == pytest.approx(shifted)
