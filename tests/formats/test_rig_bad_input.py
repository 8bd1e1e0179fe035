"""Rigs that cannot be right end in one line that names file, camera and fault; each change below is refused on its own."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from posefuse.core import CalibrationError, Rig
from posefuse.formats.rig import read_rig, write_rig

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
    with pytest.raises(CalibrationError, match=message) as caught:
        read_rig(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


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
    with pytest.raises(CalibrationError, match=rf"camera cam_0: rotation: .*{message}"):
        read_rig(tmp_path / "rig.json")


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
    with pytest.raises(CalibrationError, match=message):
        read_rig(rig_file(name, old, new))


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
    with pytest.raises(CalibrationError, match=message):
        read_rig(tmp_path / "info")


def test_files_that_are_no_rig(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="no such calibration file"):
        read_rig(tmp_path / "rig.toml")
    with pytest.raises(CalibrationError, match="expected one calibration file per camera"):
        read_rig(tmp_path)
    (tmp_path / "rig.toml").write_text("[metadata]\nerror = 1.0\n")
    with pytest.raises(CalibrationError, match="expected at least 1 camera, got 0"):
        read_rig(tmp_path / "rig.toml")
    (tmp_path / "notes.md").write_text("# hello")
    with pytest.raises(CalibrationError, match=r"known: caliscope .*; Anipose .*; Qualisys .*; ROS .*; OpenCV"):
        read_rig(tmp_path / "notes.md")
    (tmp_path / "a.json").write_text("[1, 2]")
    with pytest.raises(CalibrationError, match="known"):
        read_rig(tmp_path / "a.json")
    (tmp_path / "b.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CalibrationError, match="cannot be read as text"):
        read_rig(tmp_path / "b.toml")
    (tmp_path / "x.txt").write_text('<!DOCTYPE c [<!ENTITY a "b">]><calibration/>')
    with pytest.raises(CalibrationError, match="DOCTYPE"):
        read_rig(tmp_path / "x.txt")
