"""Motions from files: BVH, TRC, posefuse results."""

from pathlib import Path

import built
import numpy as np
import pytest
from checks import refusal
from scipy.spatial.transform import Rotation

from posefuse.core import SKELETONS, InputError, Recording
from posefuse.evaluation.biomechanics import write_biomechanics
from posefuse.formats.bvh import BvhData, write_bvh
from posefuse.formats.recording import write_recording
from posefuse.formats.trc import TrcData, write_trc
from posefuse.foundation.settings import settings_from_mapping
from posefuse_sim.body import SEGMENTS, BodyShapeSettings, SimulatedBody, build_body
from posefuse_sim.build import MovingPerson, build_person
from posefuse_sim.motion import MotionSettings
from posefuse_sim.motion.bvh import read_bvh

KEYPOINTS = SKELETONS["anatomical23"]
WORLD_FROM_FILE = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
# name, parent, offset in centimetres; arms and legs askew in the rest pose
JOINTS = [
    ("Hips", None, (0, 0, 0)), ("LeftUpLeg", "Hips", (10, -4, 1)), ("LeftLeg", "LeftUpLeg", (9, -39, 2)),
    ("LeftFoot", "LeftLeg", (3, -41, -3)), ("LeftToeBase", "LeftFoot", (1, -7, 14)), ("RightUpLeg", "Hips", (-10, -4, 1)),
    ("RightLeg", "RightUpLeg", (-9, -39, 2)), ("RightFoot", "RightLeg", (-3, -41, -3)),
    ("RightToeBase", "RightFoot", (-1, -7, 14)), ("Spine", "Hips", (0, 12, 0)), ("Chest", "Spine", (0, 20, 1)),
    ("Neck", "Chest", (0, 22, 0)), ("Head", "Neck", (0, 9, 2)), ("LeftShoulder", "Chest", (4, 16, 0)),
    ("LeftArm", "LeftShoulder", (13, 2, -1)), ("LeftForeArm", "LeftArm", (26, -9, 0)), ("LeftHand", "LeftForeArm", (23, -9, 4)),
    ("RightShoulder", "Chest", (-4, 16, 0)), ("RightArm", "RightShoulder", (-13, 2, -1)),
    ("RightForeArm", "RightArm", (-26, -9, 0)), ("RightHand", "RightForeArm", (-23, -9, 4)),
]  # fmt: skip
DIRECTIONS = [
    ("Leg", "UpLeg", "thigh"), ("Foot", "Leg", "shank"), ("ForeArm", "Arm", "upper_arm"), ("Hand", "ForeArm", "forearm"),
]  # fmt: skip


def bvh_file(folder: Path, frames: np.ndarray, names: dict[str, str] | None = None) -> str:
    """A BVH file of the joints above: frames (T, 3 + 3 J) of root position and ZXY degrees."""
    parents = [parent for _, parent, _ in JOINTS]
    ends = [(f"{name}_end", name, (0, 1, 0)) for name, _, _ in JOINTS if name not in parents]
    order, offset = [name for name, _, _ in [*JOINTS, *ends]], np.array([offset for *_, offset in [*JOINTS, *ends]], float)
    turns = [Rotation.from_euler("ZXY", frames[:, 3 * j + 3 : 3 * j + 6], degrees=True).as_matrix() for j in range(len(JOINTS))]
    still = [np.tile(np.eye(3), (len(frames), 1, 1))] * len(ends)
    data = BvhData(
        names=tuple((names or {}).get(name, name) for name in order),
        parent=np.array([order.index(parent) if parent else -1 for _, parent, _ in [*JOINTS, *ends]]),
        offset=offset,
        frame_s=0.02,
        rotation=turns + still,
        position=[frames[:, :3], *(np.tile(one, (len(frames), 1)) for one in offset[1:])],
    )
    write_bvh(folder / "motion.bvh", data)
    return str(folder / "motion.bvh")


def frames(count: int = 40, size_deg: float = 25.0) -> np.ndarray:
    t = np.arange(count)[:, None] * 0.02
    rng = np.random.default_rng(2)
    columns = 3 + 3 * len(JOINTS)
    angles = size_deg * np.sin(2 * np.pi * t * rng.uniform(0.2, 1.0, columns) + rng.uniform(0, 6, columns))
    angles[:, :3] = np.stack([20 * t[:, 0], 95 + 0 * t[:, 0], 60 * t[:, 0]], axis=-1)
    return angles


@pytest.fixture(scope="module")
def body() -> SimulatedBody:
    return build_body(BodyShapeSettings(sex=0.7, age_years=50))


def person(body: SimulatedBody, **content: object) -> MovingPerson:
    return build_person(body, settings_from_mapping(content, MotionSettings, "scene.yaml"), 1)


def test_bvh_keeps_segment_directions(tmp_path: Path, body: SimulatedBody) -> None:
    file = bvh_file(tmp_path, frames())
    data = read_bvh(file)
    times = np.arange(len(data)) * data.frame_s
    state = person(body, kind="bvh", file=file).at(times)
    _, position = data.world()
    rotation = state.world_from_segment.matrix()
    for side in ("Left", "Right"):
        for lower, upper, segment in DIRECTIONS:
            line = position[:, data.names.index(side + upper)] - position[:, data.names.index(side + lower)]
            theirs = line / np.linalg.norm(line, axis=-1, keepdims=True) @ WORLD_FROM_FILE.T
            ours = rotation[:, SEGMENTS.index(f"{side.lower()}_{segment}"), :, 1]
            assert np.abs(ours - theirs).max() < 1e-6, (side, segment)


def test_bvh_path_is_scaled_by_leg_length(tmp_path: Path, body: SimulatedBody) -> None:
    file = bvh_file(tmp_path, frames())
    data = read_bvh(file)
    state = person(body, kind="bvh", file=file, position_m=(2.0, -1.0)).at([0.0, 0.78])
    hips = state.keypoints_world[:, KEYPOINTS.indices(["left_hip", "right_hip"])].mean(axis=1)
    assert np.allclose(hips[0, :2], [2.0, -1.0], atol=1e-9)
    _, position = data.world()
    theirs = position[[0, 39]][:, [data.names.index("LeftUpLeg"), data.names.index("RightUpLeg")]].mean(axis=1)
    leg = np.linalg.norm([9, -39, 2]) + np.linalg.norm([3, -41, -3])
    points = body.points_rest
    ours = sum(np.linalg.norm(points[f"left_{a}"] - points[f"left_{b}"]) for a, b in (("hip", "knee"), ("knee", "ankle")))
    assert np.allclose((hips[1] - hips[0])[:2], (WORLD_FROM_FILE @ (theirs[1] - theirs[0]))[:2] * ours / leg, atol=1e-6)


@pytest.mark.parametrize("rest", ["tpose", "askew"])
def test_bvh_rest_pose_stands_upright(tmp_path: Path, body: SimulatedBody, rest: str) -> None:
    still = np.zeros((3, 3 + 3 * len(JOINTS)))
    still[:, 1] = 95
    if rest == "askew":
        still[:, 5] = 30.0
    state = person(body, kind="bvh", file=bvh_file(tmp_path, still), heading_deg=90).at([0.0])
    rotation = state.world_from_segment.matrix()[0]
    for segment in ("pelvis", "thorax", "head"):
        assert np.allclose(rotation[SEGMENTS.index(segment)], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-9), segment
    assert np.allclose(rotation[SEGMENTS.index("left_foot"), :, 1], [0, 0, 1], atol=1e-9)


@pytest.mark.parametrize("start", [0.0, 0.4])
def test_bvh_start_and_end(tmp_path: Path, body: SimulatedBody, start: float) -> None:
    file = bvh_file(tmp_path, frames())
    plain = person(body, kind="bvh", file=file).at([start, 0.78, 0.0])
    later = person(body, kind="bvh", file=file, start_s=start).at([0.0, 30.0, -30.0])
    assert np.allclose(plain.keypoints_world[[0, 1, 2]], later.keypoints_world, atol=1e-9)
    again = person(body, kind="bvh", file=file, loop=True).at([0.1, 0.1 + 0.78, 0.1 - 0.78])
    assert np.allclose(again.keypoints_world[0], again.keypoints_world[1:], atol=1e-9)


def test_bvh_feet_stay_above_the_floor(tmp_path: Path, body: SimulatedBody) -> None:
    state = person(body, kind="bvh", file=bvh_file(tmp_path, frames(80, 18.0))).at(np.arange(0, 1.6, 0.05))
    assert body.vertices(state.moved)[..., 2].min() > -5e-3


def test_cmu_file(shared_data: Path, body: SimulatedBody) -> None:
    file = str(shared_data / "motion" / "cmu" / "01_01.bvh")
    state = person(body, kind="bvh", file=file).at(np.arange(0, 20, 0.2))
    lowest = body.vertices(state.moved)[..., 2].min(axis=1)
    assert lowest.min() > -5e-3
    assert np.median(lowest) < 0.02
    head = state.keypoints_world[:, KEYPOINTS.index("nose"), 2]
    assert np.median(head) > 0.8 * np.ptp(body.vertices_rest[:, 2])


@pytest.mark.parametrize(
    ("names", "text"),
    [
        ({"LeftForeArm": "Banana"}, "joint for the left forearm: expected one of leftforearm, .*; there are: Hips, .*Banana"),
        ({"RightLeg": "RightArm", "RightArm": "RightLeg"}, "broken hierarchy: expected joint 'RightLeg' below 'RightUpLeg'"),
    ],
)
def test_bvh_with_unusable_joints(tmp_path: Path, body: SimulatedBody, names: dict[str, str], text: str) -> None:
    file = bvh_file(tmp_path, frames(), names)
    refusal(InputError, f"motion.bvh: {text}", person, body, kind="bvh", file=file)


@pytest.mark.parametrize(("style", "prefix"), [("mixamo", "mixamorig:"), ("spaced", "figure: ")])
def test_bvh_name_prefixes(tmp_path: Path, body: SimulatedBody, style: str, prefix: str) -> None:
    renamed = {name: prefix.strip() + name for name, *_ in JOINTS}
    plain = person(body, kind="bvh", file=bvh_file(tmp_path, frames())).at([0.3])
    other = person(body, kind="bvh", file=bvh_file(tmp_path, frames(), renamed)).at([0.3])
    assert np.array_equal(plain.moved, other.moved), style


@pytest.fixture(scope="module")
def squat(body: SimulatedBody) -> tuple[np.ndarray, np.ndarray]:
    """Times and keypoints of a person who squats facing +Y."""
    times = np.arange(0, 4, 1 / 50)
    state = person(body, kind="squat", heading_deg=90, position_m=(0.4, -0.7)).at(times)
    return times, state.keypoints_world


MARKERS = {
    "openpose": {n: n.replace("left_", "L").replace("right_", "R").title().replace("_", "") for n in KEYPOINTS.keypoints},
    "plain": {n: n for n in KEYPOINTS.keypoints},
}


@pytest.mark.parametrize("style", MARKERS)
def test_trc_moves_the_body_as_recorded(tmp_path, body, squat, style: str) -> None:
    times, points = squat
    names = [MARKERS[style][n] for n in KEYPOINTS.keypoints]
    if style == "openpose":
        names = [n.replace("Lh", "LH").replace("Rh", "RH") for n in names]
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


def test_the_skeleton_of_a_report_animates_a_person(tmp_path: Path, body: SimulatedBody, squat, ring_rig) -> None:
    """The BVH that `posefuse report` writes; knees bend as they did."""
    times, points = squat
    files = write_biomechanics(recording(times, {0: points}, ring_rig(2)), tmp_path)
    [file] = [path for path in files if path.suffix == ".bvh"]
    state = person(body, kind="bvh", file=str(file)).at(times)
    bent = [bend_deg(xyz, "left") for xyz in (state.keypoints_world, points)]
    assert np.ptp(bent[1]) > 40 and np.abs(bent[0] - bent[1]).max() < 5


def bend_deg(xyz: np.ndarray, side: str) -> np.ndarray:
    """(T,) angle between thigh and shank."""
    hip, knee, ankle = (xyz[:, KEYPOINTS.index(f"{side}_{joint}")] for joint in ("hip", "knee", "ankle"))
    thigh, shank = knee - hip, ankle - knee
    cosine = (thigh * shank).sum(axis=-1) / np.linalg.norm(thigh, axis=-1) / np.linalg.norm(shank, axis=-1)
    return np.rad2deg(np.arccos(cosine))


def test_turns_between_frames_are_the_shortest(tmp_path: Path, body: SimulatedBody) -> None:
    two = np.zeros((2, 3 + 3 * len(JOINTS)))
    two[:, 1] = 95
    two[1, 3 + 3] = 40.0
    state = person(body, kind="bvh", file=bvh_file(tmp_path, two)).at([0.0, 0.01, 0.02])
    thigh = Rotation.from_matrix(state.world_from_segment.matrix()[:, SEGMENTS.index("left_thigh")])
    assert np.rad2deg((thigh[0].inv() * thigh[1]).magnitude()) == pytest.approx(20.0, abs=1e-4)


# --- reading BVH files


ARM = """HIERARCHY
ROOT Base
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Upper
  {
    OFFSET 0 2 0
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 3 0 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
1 2 3 0 0 0 0 0 0
1 2 3 90 0 0 0 90 0
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "arm.bvh"
    path.write_text(text)
    return path


def test_positions_by_hand(tmp_path: Path) -> None:
    data = read_bvh(written(tmp_path, ARM))
    assert data.names == ("Base", "Upper", "Upper_end")
    assert data.frame_s == 0.04
    assert np.allclose(data.rest_positions(), [[0, 0, 0], [0, 2, 0], [3, 2, 0]])
    _, position = data.world()
    assert np.allclose(position[0], [[1, 2, 3], [1, 4, 3], [4, 4, 3]])
    # a quarter turn about z moves (0, 2, 0) to (-2, 0, 0); then (3, 0, 0) turned about y points along -z, which z leaves alone
    assert np.allclose(position[1], [[1, 2, 3], [-1, 2, 3], [-1, 2, 0]])


@pytest.mark.parametrize("order", ["Zrotation Xrotation Yrotation", "Xrotation Yrotation Zrotation"])
def test_channels_apply_in_the_file_s_order(tmp_path: Path, order: str) -> None:
    text = ARM.replace("Zrotation Yrotation Xrotation", order).replace("1 2 3 0 0 0 0 0 0", "1 2 3 0 0 0 20 30 40")
    rotation, _ = read_bvh(written(tmp_path, text)).world()
    axes = "".join(name[0] for name in order.split())
    assert np.allclose(rotation[0, 1], Rotation.from_euler(axes, (20, 30, 40), degrees=True).as_matrix())


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("HIERARCHY", "HIRARCHY", "line 1: expected 'HIERARCHY', got 'HIRARCHY'"),
        ("OFFSET 0 2 0", "OFFSET 0 two 0", "line 8: expected 3 numbers after OFFSET of Upper, got 'two'"),
        ("Yrotation Xrotation\n    End", "Yrotation W\n    End", "line 9: expected a channel of Upper out of .*, got 'W'"),
        ("JOINT Upper", "JOINT Base", "joint 'Base' appears twice"),
        ("}\nMOTION", "MOTION", "expected CHANNELS, JOINT, End or '}' of joint Base, got 'MOTION'"),
        ("Frames: 2", "Frames: 3", "MOTION: expected 3 frames of 9 numbers = 27, got 18 numbers"),
        ("Frame Time: 0.04", "Frame Time: 0", "frame time > 0 s, got 2 frames of 0.0 s"),
        ("1 2 3 90", "1 2 x 90", "MOTION: expected numbers only"),
        ("1 2 3 90", "1 2 nan 90", "MOTION: expected finite numbers, .* in frame 1"),
        ("MOTION", "", "expected 'MOTION'"),
    ],
)  # fmt: skip
def test_broken_files_are_named_with_their_line(tmp_path: Path, old: str, new: str, text: str) -> None:
    assert old in ARM
    path = written(tmp_path, ARM.replace(old, new))
    refusal(InputError, f"{path.name}: .*{text}", read_bvh, path)


def test_cut_off_file(tmp_path: Path) -> None:
    refusal(InputError, "got the end of the file", lambda: read_bvh(written(tmp_path, ARM[:120])))
    refusal(InputError, "none.bvh: no such file", read_bvh, tmp_path / "none.bvh")
