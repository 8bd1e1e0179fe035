"""Every rig format: round trips, agreement with independent readers and with real files."""

import json
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from checks import refusal
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from posefuse.core import SE3, CalibrationError, Camera, Rig
from posefuse.formats.rig import read_rig, rig_warnings, write_rig
from posefuse_sim.cameras import looking_at

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "files"


def same_cameras(a: Rig, b: Rig, atol: float = 1e-12) -> None:
    assert a.names == b.names
    for one, other in zip(a, b, strict=True):
        assert one.size_wh == other.size_wh
        assert one.model == other.model
        assert one.readout_s == other.readout_s
        np.testing.assert_allclose(one.K, other.K, rtol=1e-14)
        np.testing.assert_allclose(one.cam_from_world.matrix4(), other.cam_from_world.matrix4(), atol=atol)
        points = np.array([[0.1, 0.2, 1.0], [-0.3, 0.1, 1.7]])
        np.testing.assert_allclose(one.project(points), other.project(points), atol=1e-6)


@st.composite
def rigs(draw: st.DrawFn) -> Rig:
    """Rigs with every lens, skew, a rolling shutter and awkward names."""
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    cameras = []
    for i in range(draw(st.integers(1, 4))):
        is_fisheye = draw(st.booleans())
        count = 4 if is_fisheye else draw(st.sampled_from((0, 4, 5, 8, 12, 14)))
        fx = rng.uniform(900, 2000)
        K = np.array([[fx, rng.normal(), rng.uniform(100, 900)], [0, fx * rng.uniform(0.7, 1.4), 377.7], [0, 0, 1]])
        pose = SE3(rng.normal(size=4), rng.normal(size=3) * 5)
        # however they add up, no image is folded
        lens = rng.uniform(-0.005, 0.005, count)
        sensor = {"size_wh": (1280, 720 + i), "readout_s": draw(st.sampled_from([0.0, 0.0123]))}
        model = "fisheye" if is_fisheye else "pinhole"
        cameras.append(Camera(name=f"cam_{i}", K=K, cam_from_world=pose, distortion=lens, model=model, **sensor))
    residual_px, refused = draw(st.sampled_from([float("nan"), 0.375])), draw(st.sampled_from(["", "halves agree"]))
    return Rig(tuple(cameras), world_set_by='a test: "quoted"', residual_px=residual_px, refused=refused)


@given(rig=rigs())
@hypothesis_settings(max_examples=30, deadline=None)
def test_written_rigs_come_back(tmp_path_factory: pytest.TempPathFactory, rig: Rig) -> None:
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    write_rig(path, rig)
    back = read_rig(path)
    assert back.id == rig.id
    same_cameras(back, rig)
    assert back.world_set_by == rig.world_set_by
    assert back.refused == rig.refused
    np.testing.assert_equal(back.residual_px, rig.residual_px)


def test_a_stated_rolling_shutter_is_read(tmp_path: Path) -> None:
    copy = tmp_path / "camera_array.toml"
    text = (GOLDEN / copy.name).read_text()
    copy.write_text(text.replace("fisheye = false\n", "fisheye = false\nreadout_s = 0.0123\n"))
    assert read_rig(copy).cameras[0].readout_s == 0.0123


@pytest.mark.parametrize(("name", "table"), [("rig.toml", "[cam_0]\n"), ("camera_array.toml", "[cameras.0]\n")])
def test_cameras_that_are_set_to_be_ignored_are_left_out(tmp_path: Path, name: str, table: str) -> None:
    """Earlier versions of caliscope name their tables as Anipose does."""
    text = (GOLDEN / name).read_text().replace("ignore = false\n", "")
    (tmp_path / name).write_text(text.replace(table, f"{table}ignore = true\n"))
    assert read_rig(tmp_path / name).names == read_rig(GOLDEN / name).names[1:]


def test_awkward_names_and_orders_survive(tmp_path: Path, ring_rig: Callable[..., Rig]) -> None:
    new = ("metadata", 'left "front"', "left/front/", "Kamera 3 ü.", "1", "cam_metadata")
    rig = ring_rig(6).renamed({f"cam{i:02d}": name for i, name in enumerate(new)})
    write_rig(tmp_path / "rig.toml", rig)
    assert read_rig(tmp_path / "rig.toml").names == new
    assert read_rig(tmp_path / "rig.toml").id == rig.id


def test_rig_files_are_named_toml(tmp_path: Path, ring_rig: Callable[..., Rig]) -> None:
    refusal(CalibrationError, r"rig\.yaml: a rig file is TOML", lambda: write_rig(tmp_path / "rig.yaml", ring_rig(2)))
    assert not list(tmp_path.iterdir())


def test_toml_has_what_anipose_and_pose2sim_need_and_turns_as_in_opencv(tmp_path: Path, ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(3, distortion=(0.1, -0.05, 0.001, 0.002))
    write_rig(tmp_path / "rig.toml", rig)
    tables = tomllib.loads((tmp_path / "rig.toml").read_text())
    assert list(tables) == ["cam00", "cam01", "cam02", "metadata"] and set(tables["metadata"]) >= {"adjusted", "error"}
    table = tables["cam01"]
    assert set(table) >= {"name", "size", "fisheye"} and table["size"] == [640, 480]
    points = np.array([[0.3, -0.2, 1.1], [0.5, 0.4, 0.2]])
    parts = (np.array(table[key], float) for key in ("rotation", "translation", "matrix", "distortions"))
    seen, _ = cv2.projectPoints(points, *parts)
    np.testing.assert_allclose(seen[:, 0], rig["cam01"].project(points), atol=1e-6)


def test_pose2sims_toml_and_qualisys_original_are_one_rig(shared_data: Path) -> None:
    folder = shared_data / "pose2sim_single" / "calibration"
    toml, original = read_rig(folder / "Calib_qualisys.toml"), read_rig(folder / "Calib.qca.txt")
    for one, other in zip(toml, original, strict=True):
        assert one.size_wh == other.size_wh
        np.testing.assert_allclose(one.K, other.K, rtol=1e-12)
        np.testing.assert_allclose(one.cam_from_world.matrix4(), other.cam_from_world.matrix4(), atol=1e-12)
        # Pose2Sim divides the distortion by 64 as well; `test_real_chessboards_give_the_reference_lens` says which is right
        np.testing.assert_allclose(one.distortion * 64, other.distortion, rtol=1e-12)


@pytest.mark.parametrize("path", sorted(GOLDEN.glob("rig*")) + [GOLDEN / "camera_array.toml"], ids=lambda path: path.name)
def test_golden_files_still_read_as_they_did(path: Path) -> None:
    facts = json.loads((GOLDEN / "facts.json").read_text())
    same_cameras(read_rig(path), read_rig(GOLDEN / "rig.toml"), atol=1e-9)
    assert read_rig(path).id == facts["rig_id"]


# --- rigs that cannot be right end in one line that names file, camera and fault; each change below is refused on its own


MIRROR = [[1.0, 0, 0], [0, 1.0, 0], [0, 0, -1.0]]
BENT = [[1.0, 0.01, 0], [0, 1.0, 0], [0, 0, 1.0]]


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("rig.toml", "size = [640, 480]", "", r"camera cam00: size is missing; there are: name, matrix"),
        ("rig.toml", "size = [640, 480]", "size = [640.5, 480]", r"camera cam00: size: expected whole px, got 640.5 x 480"),
        ("rig.toml", "size = [640, 480]", "size = [640]", r"camera cam00: size: expected 2 numbers, got shape \(1,\)"),
        ("rig.toml", "576.0", "nan", r"camera cam00: matrix: expected finite numbers, got NaN"),
        ("rig.toml", "576.0", '"a"', r"camera cam00: matrix: expected numbers"),
        ("rig.toml", "[0.0, 0.0, 1.0]]", "[0.0, 0.0]]", r"camera cam00: matrix: expected numbers"),
        ("rig.toml", "distortions = [0.1, ", "distortions = [", r"\(pinhole\): .* 4, 5, 8, 12, 14 coefficients, got 3"),
        ("rig.toml", "fisheye = false", "fisheye = 7", r"camera cam00: fisheye: expected true or false, got 7"),
        ("rig.toml", "fisheye = false", "readout_s = -1", r"camera cam00: readout_s: expected >= 0 s, got -1"),
        ("rig.toml", "rotation = [", "rotation = [0.0, ", r"camera cam00: rotation: expected a 3x3 matrix or 3 numbers"),
        ("rig.toml", "[cam01]\nname = \"cam01\"", "[cam01]\nname = \"cam00\"", r"names must be unique, got twice: cam00"),
        ("rig.toml", "[cam00]", "[cam00", r"cannot be parsed"),
        ("rig.toml", "translation = [", "translation = [4500.0, 0.0, 2000.0]\nold = [", r"a camera 49\d\d m .* millimetres"),
        ("rig.qca.txt", 'focalLengthU="', 'old="', r"camera cam_0: <intrinsic>: focalLengthU is missing"),
        ("rig.qca.txt", 'viewrotation="0"', 'viewrotation="90"', r"camera cam_0: viewrotation: expected 0, got 90: .* export"),
        ("rig.qca.txt", 'viewrotation="0"', 'viewrotation="left"', r"camera cam_0: viewrotation: expected"),
        ("rig.qca.txt", "<transform", "<other", r"camera cam_0: <transform> is missing; there are: fov_marker"),
        ("rig.qca.txt", ' r11="', ' r11="9" old="', r"camera cam_0: rotation: not a rotation"),
        ("rig.qca.txt", ' x="', ' x="nan" old="', r"camera cam_0: x: expected finite numbers"),
        ("rig.qca.txt", "</cameras>", "", r"cannot be parsed"),
        ("camera_array.toml", "rotation = [[", "rotation = [[9.0, 0], [0, 1]]\nold = [[", r"camera cam_0: rotation: .*got shape"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_right_is_refused_by_file_camera_and_fault(
    tmp_path: Path, ring_rig: Callable[..., Rig], name: str, old: str, new: str, message: str
) -> None:
    """A good file in which one piece of text is replaced: our own, or a golden file of another format."""
    path = tmp_path / name
    if name == "rig.toml":
        write_rig(path, ring_rig(3, distortion=(0.1, -0.05, 0.001, 0.002)))
    else:
        shutil.copytree(GOLDEN, tmp_path, dirs_exist_ok=True)
    read_rig(path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    assert path.name in refusal(CalibrationError, message, read_rig, path)


@pytest.mark.parametrize(("matrix", "message"), [(MIRROR, "mirrored"), (BENT, "not a rotation matrix")])
def test_matrices_that_are_no_rotation(tmp_path: Path, ring_rig: Callable[..., Rig], matrix: list, message: str) -> None:
    path = tmp_path / "rig.toml"
    write_rig(path, ring_rig(1))
    lines = path.read_text().splitlines()
    place = next(i for i, line in enumerate(lines) if line.startswith("rotation"))

    def read_with(rotation: list) -> Rig:
        lines[place] = f"rotation = {rotation}"
        path.write_text("\n".join(lines))
        return read_rig(path)

    for good in (np.eye(3), np.round(ring_rig(1).cameras[0].cam_from_world.matrix(), 5)):
        got = read_with(good.tolist()).cameras[0].cam_from_world.matrix()
        np.testing.assert_allclose(got, good, atol=2e-5)
        np.testing.assert_allclose(got @ got.T, np.eye(3), atol=1e-14)
    refusal(CalibrationError, rf"camera cam00: rotation: .*{message}", read_with, matrix)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("rig.toml", b"[metadata]\nerror = 1.0\n", "expected at least 1 camera, got 0"),
        ("notes.md", b"# hello", r"known: caliscope .*; Anipose .*; Qualisys .*; write other cameras as TOML"),
        ("calib.json", b'{"cam": {"K": 1}}', r"write other cameras as TOML with posefuse\.Rig\(cameras\)\.save"),
        ("calib.yaml", b"%YAML:1.0\n---\nK: 1\n", "write other cameras as TOML"),
        ("page.xml", b"<page/>", "no calibration in a known format"),
        ("b.toml", b"\xff\xfe\x00", "cannot be read as text"),
        ("x.txt", b'<!DOCTYPE c [<!ENTITY a "b">]><calibration/>', "DOCTYPE"),
    ],
)
def test_files_that_are_no_rig(tmp_path: Path, name: str, content: bytes, words: str) -> None:
    refusal(CalibrationError, "no such calibration file", read_rig, tmp_path / name)
    refusal(CalibrationError, r"rig\.toml: no such calibration file", read_rig, tmp_path)
    (tmp_path / name).write_bytes(content)
    refusal(CalibrationError, words, read_rig, tmp_path / name)


def test_a_session_stands_for_its_rig_whatever_else_it_holds(ring_rig, tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.toml", ring_rig(2))
    (tmp_path / "scene.yaml").write_text("cameras: of a simulation\n")
    assert read_rig(tmp_path).id == ring_rig(2).id


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
    every = replace(rig, cameras=tuple(replace(camera, cam_from_world=read(camera.cam_from_world)) for camera in rig))
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


def test_a_principal_point_outside_of_the_image_must_be_stated(tmp_path: Path, ring_rig: Callable[..., Rig]) -> None:
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
