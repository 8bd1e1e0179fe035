"""The body model: forward kinematics, anatomy, truth about angles."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from posefuse.core import SKELETONS
from posefuse_sim.body import JOINTS, SEGMENTS, BodyShapeSettings, SimulatedBody, build_body, mesh, rotation_of
from posefuse_sim.body.anatomy import angles_of, joint_segments
from posefuse_sim.body.body import GROUPS

KEYPOINTS = SKELETONS["anatomical23"]
HINGES = {"shoulder": ("spine01", "upperarm01"), "elbow": ("upperarm02", "lowerarm01"), "wrist": ("lowerarm02", "wrist"),
          "hip": ("root", "upperleg01"), "knee": ("upperleg02", "lowerleg01"), "ankle": ("lowerleg02", "foot")}  # fmt: skip
FLIP = np.array([1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def body() -> SimulatedBody:
    return build_body(BodyShapeSettings(sex=0.3, age_years=41, height_m=1.71, muscle=0.6))


def random_turns(body: SimulatedBody, count: int, size_rad: float) -> dict[str, np.ndarray]:
    """World turns of every bone: each turned a little against its parent."""
    rng = np.random.default_rng(5)
    turns: dict[str, np.ndarray] = {}
    for name, parent in zip(body.bone_names, body.bone_parent, strict=True):
        local = Rotation.from_rotvec(rng.uniform(-size_rad, size_rad, (count, 3)) / np.sqrt(3)).as_matrix()
        turns[name] = local if parent < 0 else turns[body.bone_names[parent]] @ local
    return turns


# sliders of anny, and what it gives there in our axes: stature in metres, mass in kilograms, places of its own origin
ANNY = (
    (
        {"gender": 0.0, "age": 2 / 3, "muscle": 0.5, "weight": 0.5, "height": 0.5},
        (1.908700, 83.20386, {"nose": (0.172031, 0, 0.936633), "left_wrist": (0.23231, 0.538728, 0.348986)}),
    ),
    (
        {"gender": 0.7, "age": 0.41, "muscle": 0.9, "weight": 0.2, "height": 0.83},
        (1.814067, 56.52987, {"nose": (0.159419, 0, 0.844364), "left_wrist": (0.203952, 0.474817, 0.295222)}),
    ),
)


@pytest.mark.parametrize(("sliders", "known"), ANNY)
def test_the_body_is_the_one_that_was_exported(sliders: dict[str, float], known: tuple[float, float, dict]) -> None:
    stature_m, mass_kg, places = known
    ours = mesh._model()
    vertices, _ = ours.at(sliders)
    assert ours.stature_m(sliders) == pytest.approx(stature_m, abs=5e-6)
    corners = vertices[ours.faces]
    volume = abs(np.einsum("fi,fi->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2])) / 6
    assert volume * 980 == pytest.approx(mass_kg, abs=1e-3)
    points = ours.keypoint_weight @ vertices
    np.testing.assert_allclose(points[KEYPOINTS.indices(places)], list(places.values()), atol=5e-6)


@pytest.mark.parametrize("joint", HINGES)
@pytest.mark.parametrize(("side", "letter"), [("left", "L"), ("right", "R")])
def test_joint_centre_is_fixed_in_both_segments(body: SimulatedBody, joint: str, side: str, letter: str) -> None:
    turns = random_turns(body, 6, size_rad=1.5)
    if joint == "shoulder":
        # the girdle is no part of the shoulder's proximal side here
        turns |= dict.fromkeys((f"clavicle.{letter}", f"shoulder01.{letter}"), turns["spine01"])
    if joint == "hip":
        turns[f"pelvis.{letter}"] = turns["root"]
    for half in ("upperarm", "lowerarm", "upperleg", "lowerleg"):
        turns[f"{half}02.{letter}"] = turns[f"{half}01.{letter}"]
    moved = body.pose(turns, np.zeros((6, 3)))
    point = body.keypoints(moved)[:, KEYPOINTS.index(f"{side}_{joint}")]
    for bone in HINGES[joint]:
        name = bone if bone in body.bone_names else f"{bone}.{letter}"
        at = moved[:, body.bone(name)]
        local = np.einsum("tij,tj->ti", np.linalg.inv(at)[:, :3, :3], point - at[:, :3, 3])
        assert np.abs(local - body.points_rest[f"{side}_{joint}"]).max() < 1e-9


def test_body_is_mirror_symmetric(body: SimulatedBody) -> None:
    for name, point in body.points_rest.items():
        other = KEYPOINTS.keypoints[KEYPOINTS.mirror[KEYPOINTS.index(name)]]
        assert np.allclose(point, body.points_rest[other] * FLIP, atol=2e-3), name
    angles = body.angles(np.tile(np.eye(4), (1, len(body.bone_names), 1, 1)))[0]
    for joint in JOINTS:
        if joint.startswith("left_"):
            assert np.allclose(angles[JOINTS.index(joint)], angles[JOINTS.index("right_" + joint[5:])], atol=np.deg2rad(0.5))


def test_stands_on_the_floor_facing_x(body: SimulatedBody) -> None:
    assert body.vertices_rest[:, 2].min() == pytest.approx(0.0, abs=1e-12)
    hips = (body.points_rest["left_hip"] + body.points_rest["right_hip"]) / 2
    assert np.allclose(hips[:2], 0.0, atol=1e-12)
    assert body.points_rest["nose"][0] > body.points_rest["left_ear"][0]
    assert body.points_rest["left_hip"][1] > 0 > body.points_rest["right_hip"][1]


def test_skin_weights_and_colours(body: SimulatedBody) -> None:
    assert np.allclose(body.bone_weight.sum(axis=1), 1.0)
    assert (np.bincount(body.colour_group, minlength=len(GROUPS)) > 100).all()
    assert body.colours.shape == (len(GROUPS), 3)


@pytest.mark.parametrize("joint", JOINTS)
def test_angles_come_back(joint: str) -> None:
    rng = np.random.default_rng(1)
    angles = rng.uniform(-1.2, 1.2, (20, 3))
    if joint.endswith("shoulder"):
        angles[:, 1] = np.abs(angles[:, 1]) + 0.1
    assert np.allclose(angles_of(joint, rotation_of(joint, angles)), angles, atol=1e-12)


@pytest.mark.parametrize("joint", JOINTS)
def test_truth_gives_back_an_imposed_rotation(body: SimulatedBody, joint: str) -> None:
    wanted = np.deg2rad([33.0, 21.0, -14.0])
    parent, child = joint_segments(joint)
    rest = body.segment_axes
    world = Rotation.from_euler("zyx", [0.4, -0.7, 1.1]).as_matrix()
    imposed = world @ rest[SEGMENTS.index(parent)] @ rotation_of(joint, wanted) @ rest[SEGMENTS.index(child)].T
    turns = dict.fromkeys(body.bone_names, world[None])
    bone = body.bone_names[body.segment_bone[SEGMENTS.index(child)]]
    for b, name in enumerate(body.bone_names):
        line, up = [name], b
        while body.bone_parent[up] >= 0:
            up = body.bone_parent[up]
            line.append(body.bone_names[up])
        if bone in line:
            turns[name] = imposed[None]
    moved = body.pose(turns, np.array([[0.3, 1.7, 0.9]]))
    assert np.allclose(body.angles(moved)[0, JOINTS.index(joint)], wanted, atol=1e-9)


@pytest.mark.parametrize(
    ("joint", "angle", "moves", "towards"),
    [
        ("right_hip", 0, "right_knee", [1, 0, 0]), ("left_hip", 0, "left_knee", [1, 0, 0]),
        ("right_hip", 1, "right_knee", [0, 1, 0]), ("left_hip", 1, "left_knee", [0, -1, 0]),
        ("right_knee", 0, "right_ankle", [-1, 0, 0]), ("left_knee", 0, "left_ankle", [-1, 0, 0]),
        ("right_ankle", 0, "right_big_toe", [0, 0, 1]), ("left_ankle", 2, "left_big_toe", [0, -1, 0]),
        ("right_ankle", 2, "right_big_toe", [0, 1, 0]), ("trunk", 0, "nose", [1, 0, 0]), ("trunk", 1, "nose", [0, -1, 0]),
        ("neck", 2, "nose", [0, 1, 0]), ("right_elbow", 0, "right_wrist", [1, 0, 0]),
    ],
)  # fmt: skip
def test_positive_angles_mean_what_they_are_called(body, joint: str, angle: int, moves: str, towards: list[int]) -> None:
    def point(value: float) -> np.ndarray:
        axes = {"pelvis": np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])}
        for j in JOINTS:
            parent, child = joint_segments(j)
            angles = np.zeros(3)
            if j == joint:
                angles[angle] = value
            axes[child] = axes[parent] @ rotation_of(j, angles)
        turns = {"root": np.eye(3)[None]}
        for segment, frame in axes.items():
            s = SEGMENTS.index(segment)
            turns[body.bone_names[body.segment_bone[s]]] = (frame @ body.segment_axes[s].T)[None]
        return body.keypoints(body.pose(turns, np.zeros((1, 3))))[0, KEYPOINTS.index(moves)]

    assert (point(0.15) - point(0.0)) @ np.array(towards) > 0.005


def test_stature_is_met() -> None:
    body = build_body(BodyShapeSettings(sex="female", height_m=1.58))
    assert np.ptp(body.vertices_rest[:, 2]) == pytest.approx(1.58, abs=2e-3)


def test_same_seed_same_body() -> None:
    one, same, other = (build_body(BodyShapeSettings(random_seed=seed)) for seed in (3, 3, 4))
    assert one.vertices_rest.tobytes() == same.vertices_rest.tobytes()
    assert np.array_equal(one.colours, same.colours)
    assert one.settings != other.settings
    kept = build_body(BodyShapeSettings(random_seed=3, height_m=1.66))
    assert kept.settings.height_m == 1.66
    assert kept.settings.hair == one.settings.hair
