"""Motions from files: TRC, posefuse results."""

from pathlib import Path

import built
import numpy as np
import pytest
from checks import refusal
from scipy.spatial.transform import Rotation

from posefuse.core import SKELETONS, InputError, Recording
from posefuse.formats.recording import write_recording
from posefuse.formats.trc import TrcData, write_trc
from posefuse.foundation.settings import settings_from_mapping
from posefuse_sim.body import SEGMENTS, BodyShapeSettings, SimulatedBody, build_body
from posefuse_sim.build import MovingPerson, build_person
from posefuse_sim.motion import MotionSettings

KEYPOINTS = SKELETONS["anatomical23"]


@pytest.fixture(scope="module")
def body() -> SimulatedBody:
    return build_body(BodyShapeSettings(sex=0.7, age_years=50))


def person(body: SimulatedBody, **content: object) -> MovingPerson:
    return build_person(body, settings_from_mapping(content, MotionSettings, "scene.yaml"), 1)


@pytest.fixture(scope="module")
def squat(body: SimulatedBody) -> tuple[np.ndarray, np.ndarray]:
    """Times and keypoints of a person who squats facing +Y."""
    times = np.arange(0, 4, 1 / 50)
    state = person(body, kind="squat", heading_deg=90, position_m=(0.4, -0.7)).at(times)
    return times, state.keypoints_world


def _pose2sim_name(keypoint: str) -> str:
    """``LBigToe`` of left_big_toe."""
    return keypoint.replace("left_", "l_").replace("right_", "r_").title().replace("_", "")


MARKERS = {
    "pose2sim": {n: _pose2sim_name(n) for n in KEYPOINTS.keypoints},
    "plain": {n: n for n in KEYPOINTS.keypoints},
}


@pytest.mark.parametrize("style", MARKERS)
def test_trc_moves_the_body_as_recorded(tmp_path, body, squat, style: str) -> None:
    times, points = squat
    names = [MARKERS[style][n] for n in KEYPOINTS.keypoints]
    write_trc(tmp_path / "squat.trc", TrcData(names=tuple(names), t_s=times, xyz_world=points, rate_hz=50.0))
    state = person(body, kind="trc", file=str(tmp_path / "squat.trc")).at(times)
    error = np.linalg.norm(state.keypoints_world - points, axis=-1)
    limbs = KEYPOINTS.indices([f"{s}_{j}" for s in ("left", "right") for j in ("hip", "knee", "ankle")])
    assert np.median(error[:, limbs]) < 3e-3
    assert np.median(error) < 25e-3


def test_trc_gaps_are_closed_and_missing_markers_named(tmp_path, body, squat) -> None:
    times, points = squat
    holes = points.copy()
    holes[20:24, KEYPOINTS.index("left_knee")] = np.nan
    write_trc(tmp_path / "holes.trc", TrcData(names=KEYPOINTS.keypoints, t_s=times, xyz_world=holes, rate_hz=50.0))
    state = person(body, kind="trc", file=str(tmp_path / "holes.trc")).at(times)
    assert np.isfinite(state.keypoints_world).all()
    few = tuple(n.replace("left_knee", "marker7") for n in KEYPOINTS.keypoints)
    write_trc(tmp_path / "few.trc", TrcData(names=few, t_s=times, xyz_world=points, rate_hz=50.0))
    with pytest.raises(InputError, match=r"few.trc: expected points for left_knee; there are: nose, .*marker7"):
        person(body, kind="trc", file=str(tmp_path / "few.trc"))
    holes[:, KEYPOINTS.index("left_knee")] = np.nan
    write_trc(tmp_path / "none.trc", TrcData(names=KEYPOINTS.keypoints, t_s=times, xyz_world=holes, rate_hz=50.0))
    with pytest.raises(InputError, match=r"none.trc: left_knee: expected at least one finite position, got none"):
        person(body, kind="trc", file=str(tmp_path / "none.trc"))


def test_real_trc(shared_data: Path, body: SimulatedBody) -> None:
    folder = shared_data / "pose2sim_single" / "reference"
    file = next(folder.glob("*butterworth.trc"))
    state = person(body, kind="trc", file=str(file)).at(np.arange(0, 1.6, 0.05))
    assert body.vertices(state.moved)[..., 2].min() > -5e-3
    left, right = (state.keypoints_world[:, KEYPOINTS.index(f"{s}_ankle"), 2] for s in ("left", "right"))
    assert np.abs(left - right).max() > 0.25, "he lifts one leg"


def recording(times: np.ndarray, people: dict[int, np.ndarray], rig) -> Recording:
    xyz = np.stack(list(people.values()), axis=1)
    poses = built.poses(xyz, skeleton=KEYPOINTS, t_ns=(times * 1e9).astype(np.int64), ids=list(people))
    return built.recording(rig, poses, score=0.0)


def test_result_animates_a_person(tmp_path: Path, body: SimulatedBody, squat: tuple[np.ndarray, np.ndarray], ring_rig) -> None:
    times, points = squat
    seldom = points + [1.0, 0, 0]
    seldom[: len(times) // 2] = np.nan
    write_recording(tmp_path, recording(times, {4: seldom, 9: points}, ring_rig(2)))
    state = person(body, kind="result", file=str(tmp_path)).at(times)
    knees = KEYPOINTS.indices(["left_knee", "right_knee"])
    assert np.median(np.linalg.norm(state.keypoints_world - points, axis=-1)[:, knees]) < 3e-3
    moved = person(body, kind="result", file=str(tmp_path), person=9, position_m=(5.0, 5.0)).at(times)
    assert np.allclose(moved.keypoints_world[:, knees, 2], state.keypoints_world[:, knees, 2])
    refusal(InputError, "person: no person 3; there are: 4, 9", person, body, kind="result", file=str(tmp_path), person=3)


def test_the_first_and_the_last_pose_stay(tmp_path: Path, body: SimulatedBody, squat) -> None:
    times, points = squat
    write_trc(tmp_path / "squat.trc", TrcData(names=KEYPOINTS.keypoints, t_s=times, xyz_world=points, rate_hz=50.0))
    state = person(body, kind="trc", file=str(tmp_path / "squat.trc")).at([0.0, float(times[-1]), -30.0, 30.0])
    assert np.allclose(state.keypoints_world[:2], state.keypoints_world[2:], atol=1e-9)


def test_feet_are_raised_where_they_would_be_below_the_floor(tmp_path: Path, body: SimulatedBody, squat) -> None:
    times, points = squat
    sunk = points - [0, 0, 0.1]
    write_trc(tmp_path / "sunk.trc", TrcData(names=KEYPOINTS.keypoints, t_s=times, xyz_world=sunk, rate_hz=50.0))
    state = person(body, kind="trc", file=str(tmp_path / "sunk.trc")).at(times[::10])
    assert body.vertices(state.moved)[..., 2].min() > -5e-3


def test_turns_between_frames_are_the_shortest(tmp_path: Path, body: SimulatedBody, squat) -> None:
    _, points = squat
    angle = np.deg2rad(40.0)
    turned = points[0] @ np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    two = TrcData(names=KEYPOINTS.keypoints, t_s=np.array([0.0, 0.02]), xyz_world=np.stack([points[0], turned]), rate_hz=50.0)
    write_trc(tmp_path / "two.trc", two)
    state = person(body, kind="trc", file=str(tmp_path / "two.trc")).at([0.0, 0.01, 0.02])
    pelvis = Rotation.from_matrix(state.world_from_segment.matrix()[:, SEGMENTS.index("pelvis")])
    assert np.rad2deg((pelvis[0].inv() * pelvis[1]).magnitude()) == pytest.approx(20.0, abs=1e-3)
