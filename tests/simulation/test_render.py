"""One frame: shutter, exposure, noise, and the backends."""

import dataclasses
import os
import sys

import numpy as np
import pytest
from calibrating import refined
from checks import refusal
from running import python
from scenes import PLAIN_ROOM, chess_corners, listed, marker_corners, scene, still

from posefuse.calibration.targets.detection import TargetDetector
from posefuse.calibration.targets.kinds import Markers
from posefuse.core import SE3, DependencyError, Frame
from posefuse.core.skeleton import ANATOMICAL23, pick_keypoints
from posefuse.detection.blazepose import BlazePoseConfig
from posefuse_sim import build
from posefuse_sim.build import LiveScene, live_scene
from posefuse_sim.cameras import SensorSettings
from posefuse_sim.exact import seen_points
from posefuse_sim.render import stage as backends
from posefuse_sim.render.shot import moments_of
from posefuse_sim.scene import Scene

_SPEED_MPS = 3.0
_BOARD = {"kind": "charuco_board", "squares": [5, 7], "square_m": 0.14, "marker_m": 0.05, "path": still([-1.5, 0.0, 0.9])}
_EYE = {"name": "eye", "position_m": [0.0, 0.0, 2.6], "look_at_m": [0.0, 0.0, 0.9], "image": {"size_px": [400, 300]}}


def _scene(seed: int = 0, **sensor) -> Scene:
    """A board that flies sideways past a camera which looks straight at it."""
    return scene(rate_hz=20, seed=seed, cameras=listed({**_EYE, "sensor": sensor}), props=[_BOARD], room=PLAIN_ROOM)


@pytest.fixture(autouse=True)
def flies(monkeypatch):
    """What stands flies along x instead."""

    def poses(path, t_s, seed):
        ahead = np.asarray(t_s)[:, None] * [_SPEED_MPS, 0.0, 0.0]
        return SE3(np.tile([1.0, 0, 0, 0], (len(t_s), 1)), np.array(path.position_m) + ahead)

    monkeypatch.setattr(build, "poses_on_path", poses)


def _chess_px(live: LiveScene, frame: int) -> np.ndarray:
    """(Q, 2) corners of the board, each where it is when its own row is exposed."""
    camera, chess = live.rig.cameras[0], chess_corners(live.scene.props[0])
    late_s = np.zeros(len(chess))
    for _ in range(20):
        px = camera.project(chess + live.prop_poses(live.shots[0].t_ns[frame] / 1e9 + late_s)[0].xyz)
        late_s = camera.readout_s * (px[:, 1] / (camera.size_wh[1] - 1) - 0.5)
    return px


@pytest.mark.gl
def test_a_rolling_shutter_shears_moving_parts_as_the_truth_states(shots):
    rolling = _scene(readout_s=0.03, shutter_bands=60)
    frame = 10
    live, [shot] = shots(rolling, frame)
    expected, frozen = _chess_px(live, frame), _chess_px(live_scene(_scene()), frame)
    # the top and the bottom of the picture are seen at different moments
    assert np.ptp((expected - frozen)[:, 0]) > 8
    error = refined(shot.image, expected, 4) - expected
    assert np.abs(error).max() < 0.5
    assert np.linalg.norm(error.mean(axis=0)) < 0.1


@pytest.mark.gl
def test_exposure_smears_along_the_motion_only(shots):
    live, [sharp] = shots(_scene(), 10)
    _, [smeared] = shots(_scene(exposure_s=0.03, blur_samples=9), 10)
    corners = _chess_px(live, 10)
    (left, top), (right, bottom) = corners.min(axis=0).astype(int), corners.max(axis=0).astype(int)
    board = (slice(top, bottom), slice(left + 20, right - 20))
    grey = [shot.image[board].astype(float).mean(axis=2) for shot in (sharp, smeared)]
    along, across = ([np.square(np.diff(one, axis=axis)).mean() for one in grey] for axis in (1, 0))
    assert along[1] / along[0] < 0.6 * across[1] / across[0]
    assert along[1] < 0.3 * along[0]


@pytest.mark.gl
def test_noise_has_its_size_and_its_seed(shots):
    images = [shots(_scene(seed, noise_dn=4.0))[1][0].image for seed in (1, 1, 2)]
    clean = shots(_scene(1))[1][0].image
    np.testing.assert_array_equal(images[0], images[1])
    assert not np.array_equal(images[0], images[2])
    inner = (clean > 30) & (clean < 220)
    expected = 4.0 * np.sqrt(0.25 + 0.75 * clean / 118)
    assert ((images[0].astype(float) - clean) / expected)[inner].std() == pytest.approx(1.0, rel=0.03)


@pytest.mark.gl
def test_what_is_printed_on_a_prop_is_as_sharp_on_a_side_seen_askew(shots):
    cube = {"kind": "aruco_cube", "side_m": 0.36, "marker_m": 0.28, "path": still([0.0, 0.0, 0.9])}
    eyes = [{**_EYE, "position_m": [2.2, 0.4 + 0.1 * i, 1.5 + 0.1 * i]} for i in range(6)]
    off = []
    for eye in eyes:
        live, [shot] = shots(scene(cameras=listed(eye), props=[cube], room=PLAIN_ROOM), 0)
        [made], [path] = live.scene.props, live.prop_poses(np.zeros(1))
        truth = live.rig.cameras[0].project(marker_corners(made) + path.xyz[0])
        found = TargetDetector(Markers(0.28)).detect(shot.image[..., 1])
        assert len(found.patch) >= 8
        off.extend(np.abs(found.xy_img - truth[found.patch, found.corner]).max(axis=1))
    assert np.mean(off) < 0.05


def test_moments_cover_the_rows_once_and_the_readout_symmetrically():
    moments = moments_of(SensorSettings(readout_s=0.02, shutter_bands=7, exposure_s=0.01, blur_samples=3), 101)
    rows = np.concatenate([np.arange(m.first_row, m.last_row) for m in moments if m.middle])
    np.testing.assert_array_equal(rows, np.arange(101))
    after = np.array([m.after_s for m in moments])
    assert after.mean() == pytest.approx(0, abs=2e-4)
    assert np.ptp(after) < 0.02 + 0.01
    assert len(moments_of(SensorSettings(), 480)) == 1


_DRAW = """
import sys
import numpy as np
from scenes import scene
from posefuse.core.ideal_image import optics_of
from posefuse_sim.build import live_scene
from posefuse_sim.render.model import render_model
from posefuse_sim.render.stage import RenderStage
live, name = live_scene(scene(cameras={"kind": "ring", "image": {"size_px": [64, 48]}})), sys.argv[1]
stage, eye = RenderStage(render_model(live, live.rig, name), name), live.rig.cameras[0]
stage.place(np.zeros((0, 7)))
image, depth = stage.draw(optics_of(eye).view, eye.cam_from_world)
stage.close()
print(int(image.mean()), round(float(depth[40, 32]), 2))
"""


@pytest.mark.gl
@pytest.mark.parametrize("name", backends.BACKENDS)
def test_each_backend_draws_or_is_skipped_by_name(name, backend):
    reason = backends._why_not(name)
    if reason is not None:
        pytest.skip(f"{name} does not work here: {reason}")
    run = python("-c", _DRAW, name, PYTHONPATH=os.pathsep.join(sys.path))
    assert run.returncode == 0, run.stderr
    brightness, depth_m = run.stdout.split()
    assert 60 < int(brightness) < 220
    assert 3.0 < float(depth_m) < 5.0


@pytest.mark.parametrize(
    ("reason", "named"),
    [
        ("cannot open shared object file", r"egl: cannot open.*osmesa: cannot open.*libegl1 .*libosmesa6"),
        ("ModuleNotFoundError: No module named 'mujoco'", r"pip install 'posefuse\[sim\]'"),
    ],
)
def test_without_opengl_or_the_extra_the_error_names_what_is_missing(monkeypatch, reason, named):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(backends, "_why_not", lambda name: reason)
    backends._first_working.cache_clear()
    try:
        refusal(DependencyError, named, backends.working_backend)
    finally:
        backends._first_working.cache_clear()


def test_the_reason_is_what_the_process_met_and_no_advice_of_its_own(monkeypatch, tmp_path):
    (tmp_path / "mujoco.py").write_text("raise ModuleNotFoundError(\"No module named 'mujoco'\")", encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    assert backends._why_not("egl") == "ModuleNotFoundError: No module named 'mujoco'"


@pytest.mark.gl
def test_two_stages_of_one_process_do_not_disturb_each_other(shots):
    _, [first] = shots(_scene(1))
    shots(dataclasses.replace(_scene(2), props=()))
    np.testing.assert_array_equal(shots(_scene(1))[1][0].image, first.image)


# --- are the pictures good enough? The real network looks at a simulated person from every side


_JOINTS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_LIMBS = tuple(f"{side}_{joint}" for side in ("left", "right") for joint in _JOINTS)


@pytest.fixture(scope="module")
def network(models):
    return BlazePoseConfig(streams=1).build()


@pytest.mark.gl
@pytest.mark.parametrize("sex", ["female", "male"])
def test_the_network_finds_the_person_from_every_side(sex, network, shots):
    person = {"body": {"sex": sex}, "motion": {"kind": "wave", "heading_deg": 15}}
    live, taken = shots(scene(cameras={"kind": "ring", "count": 8, "radius_m": 4.0}, people=[person]))
    frames, truth = [], []
    for c, (camera, shot) in enumerate(zip(live.rig, taken, strict=True)):
        frames.append(Frame(camera=camera.name, seq=0, t_ns=0, received_ns=0, image=shot.image))
        truth.append(np.where(shot.visible[:, None], seen_points(live, c, slice(0, 1)).xy_img[0], np.nan))
    found = network.detect(frames, [None] * 8)
    assert [len(one) for one in found] == [1] * 8
    expected = pick_keypoints(np.stack(truth), ANATOMICAL23, _LIMBS)
    seen = pick_keypoints(np.stack([one.xy_img[0] for one in found]), network.skeleton, _LIMBS)
    error_px = np.linalg.norm(seen - expected, axis=-1)
    # the person is some 250 px tall: a left for a right would be off by more than 20 px
    assert np.nanmedian(error_px) < 6
    assert np.nanquantile(error_px, 0.9) < 15
