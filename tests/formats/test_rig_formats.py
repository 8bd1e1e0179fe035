"""Every rig format: round trips, agreement with independent readers and with real files."""

import json
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from checks import refusal
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from posefuse.core import SE3, CalibrationError, Camera, Rig
from posefuse.formats.rig import read_rig, write_rig

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
        lens = rng.normal(size=count) * 0.02
        cameras.append(
            Camera(
                name=f"cam_{i}",
                size_wh=(1280, 720 + i),
                K=K,
                cam_from_world=pose,
                distortion=lens,
                model="fisheye" if is_fisheye else "pinhole",
                readout_s=draw(st.sampled_from([0.0, 0.0123])),
            )
        )
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


@pytest.mark.parametrize(
    ("name", "before", "stated"),
    [
        ("rig.yaml", "   image_width: 1280\n", "   readout_s: 0.0123\n"),
        ("rig.json", '"image_width": 1280,', '"readout_s": 0.0123,'),
        ("rig_ros/cam_0.yaml", "image_width: 1280\n", "readout_s: 0.0123\n"),
        ("camera_array.toml", "fisheye = false\n", "readout_s = 0.0123\n"),
    ],
)
def test_a_stated_rolling_shutter_is_read(tmp_path: Path, name: str, before: str, stated: str) -> None:
    copy = tmp_path / Path(name).name
    copy.write_text((GOLDEN / name).read_text().replace(before, before + stated))
    assert read_rig(copy).cameras[0].readout_s == 0.0123


def test_awkward_names_and_orders_survive(tmp_path: Path, ring_rig: Callable[..., Rig]) -> None:
    new = ("metadata", 'left "front"', "left/front/", "Kamera 3 ü.", "1", "cam_metadata")
    rig = ring_rig(6).renamed({f"cam{i:02d}": name for i, name in enumerate(new)})
    write_rig(tmp_path / "rig.toml", rig)
    assert read_rig(tmp_path / "rig.toml").names == new
    assert read_rig(tmp_path / "rig.toml").id == rig.id


def test_rig_files_are_named_toml(tmp_path: Path, ring_rig: Callable[..., Rig]) -> None:
    refusal(CalibrationError, r"rig\.yaml: a rig file is TOML", lambda: write_rig(tmp_path / "rig.yaml", ring_rig(2)))
    assert not list(tmp_path.iterdir())


def test_toml_has_what_anipose_and_pose2sim_need(tmp_path: Path, ring_rig: Callable[..., Rig]) -> None:
    rig = ring_rig(3, distortion=(0.1, -0.05, 0.001, 0.002))
    write_rig(tmp_path / "rig.toml", rig)
    tables = tomllib.loads((tmp_path / "rig.toml").read_text())
    assert list(tables) == ["cam00", "cam01", "cam02", "metadata"]
    assert set(tables["cam01"]) >= {"name", "size", "matrix", "distortions", "rotation", "translation", "fisheye"}
    assert tables["cam01"]["size"] == [640, 480]
    assert np.shape(tables["cam01"]["rotation"]) == (3,)
    assert set(tables["metadata"]) >= {"adjusted", "error"}


def test_a_rotation_vector_turns_as_in_opencv(tmp_path: Path, ring_rig: Callable[..., Rig]) -> None:
    cv2 = pytest.importorskip("cv2")
    rig = ring_rig(3, distortion=(0.1, -0.05, 0.001, 0.002))
    write_rig(tmp_path / "rig.toml", rig)
    table = tomllib.loads((tmp_path / "rig.toml").read_text())["cam01"]
    points = np.array([[0.3, -0.2, 1.1], [0.5, 0.4, 0.2]])
    parts = (np.array(table[key], float) for key in ("rotation", "translation", "matrix", "distortions"))
    seen, _ = cv2.projectPoints(points, *parts)
    np.testing.assert_allclose(seen[:, 0], rig["cam01"].project(points), atol=1e-6)


@pytest.mark.parametrize("ending", ["yaml", "json"])
def test_we_read_opencvs_files(tmp_path: Path, ring_rig: Callable[..., Rig], ending: str) -> None:
    cv2 = pytest.importorskip("cv2")
    rig = ring_rig(3, distortion=(1e-5, -0.05, 1e-7, 0.002, 0.03))
    (tmp_path / "cameras").mkdir()
    for camera in rig:
        storage = cv2.FileStorage(str(tmp_path / "cameras" / f"{camera.name}.{ending}"), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", camera.size_wh[0])
        storage.write("image_height", camera.size_wh[1])
        storage.write("cameraMatrix", camera.K)
        storage.write("distCoeffs", camera.distortion.reshape(1, 5))
        storage.write("rvec", camera.cam_from_world.rotvec().reshape(3, 1))
        storage.write("tvec", camera.cam_from_world.xyz.reshape(3, 1))
        storage.release()
    assert read_rig(tmp_path / "cameras").id == rig.id


def test_pose2sims_toml_and_qualisys_original_are_one_rig(shared_data: Path) -> None:
    folder = shared_data / "pose2sim_single" / "calibration"
    toml, original = read_rig(folder / "Calib_qualisys.toml"), read_rig(folder / "Calib.qca.txt")
    for one, other in zip(toml, original, strict=True):
        assert one.size_wh == other.size_wh
        np.testing.assert_allclose(one.K, other.K, rtol=1e-12)
        np.testing.assert_allclose(one.cam_from_world.matrix4(), other.cam_from_world.matrix4(), atol=1e-12)
        # Pose2Sim divides the distortion by 64 as well; the board test below says which is right
        np.testing.assert_allclose(one.distortion * 64, other.distortion, rtol=1e-12)


@pytest.mark.slow
def test_qualisys_distortion_is_what_a_board_shows(shared_data: Path) -> None:
    """Calibrating from photographs through the same lenses gives the file's coefficients, not a 64th of them."""
    import cv2

    folder = shared_data / "pose2sim_single" / "calibration"
    rig = read_rig(folder / "Calib.qca.txt")
    board = np.zeros((28, 3), np.float32)
    board[:, :2] = np.mgrid[0:7, 0:4].T.reshape(-1, 2) * 0.06
    for name in ("cam02", "cam03", "cam04"):
        corners = []
        for path in sorted((folder / "intrinsics" / f"int_{name}_img").glob("*.jpg")):
            found, xy = cv2.findChessboardCornersSB(cv2.imread(str(path), 0), (7, 4), flags=cv2.CALIB_CB_EXHAUSTIVE)
            corners += [xy] if found else []
        flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_PRINCIPAL_POINT
        _, _, lens, _, _ = cv2.calibrateCamera(
            [board] * len(corners), corners, rig[name].size_wh, rig[name].K.copy(), np.zeros(4), flags=flags
        )
        np.testing.assert_allclose(lens.ravel()[0], rig[name].distortion[0], atol=0.01)
        np.testing.assert_allclose(lens.ravel()[1], rig[name].distortion[1], atol=0.03)


def test_caliscopes_own_file(shared_data: Path) -> None:
    rig = read_rig(shared_data / "caliscope" / "post_optimization" / "camera_array.toml")
    assert rig.names == ("cam_0", "cam_1", "cam_2", "cam_3")
    np.testing.assert_allclose(rig["cam_2"].cam_from_world.xyz, [-0.23847883889454596, 0.18461082840729343, 1.1682943900670697])
    assert rig["cam_0"].distortion[4] == 0.0665682301495769


@pytest.mark.parametrize("path", sorted(GOLDEN.glob("rig*")) + [GOLDEN / "camera_array.toml"], ids=lambda path: path.name)
def test_golden_files_still_read_as_they_did(path: Path) -> None:
    facts = json.loads((GOLDEN / "facts.json").read_text())
    same_cameras(read_rig(path), read_rig(GOLDEN / "rig.toml"), atol=1e-9)
    assert read_rig(path).id == facts["rig_id"]
