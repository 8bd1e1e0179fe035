"""Motions: on planted feet, and walking with feet that do not slide, the asked speed and human joint angles."""

import numpy as np
import pytest

from posefuse.core import SKELETONS
from posefuse.foundation.settings import settings_from_mapping
from posefuse_sim.body import JOINTS, SEGMENTS, BodyShapeSettings, SimulatedBody, build_body
from posefuse_sim.build import MovingPerson, PersonState, build_person
from posefuse_sim.motion import MotionSettings

KEYPOINTS = SKELETONS["anatomical23"]
HZ = 120.0
PATHS = {
    "circle": ({"shape": "circle", "radius_m": 1.5}, 1.35),
    "clockwise": ({"shape": "circle", "radius_m": 1.0, "clockwise": True, "centre_m": (3.0, -2.0)}, 0.9),
    "line": ({"shape": "line", "start_m": (-2.0, 0.5), "end_m": (2.5, 1.5)}, 1.2),
    "turning": ({"shape": "back_forth", "start_m": (-1.5, 0.0), "end_m": (1.5, 0.0)}, 1.0),
    "sideways": ({"shape": "back_forth", "start_m": (-1.5, 0.2), "end_m": (1.5, 0.2), "facing": "sideways"}, 0.9),
    "random": ({"shape": "random", "low_m": (-2.0, -1.5), "high_m": (2.0, 1.5)}, 1.1),
}


def person(body: SimulatedBody, seed: int = 7, **content: object) -> MovingPerson:
    needed = {"path": PATHS["random"][0]} if content["kind"] == "walk" else {}
    return build_person(body, settings_from_mapping(needed | content, MotionSettings, "scene.yaml"), seed)


def walk(body: SimulatedBody, path: dict, speed_mps: float, times: np.ndarray) -> PersonState:
    return person(body, 3, kind="walk", path=path, speed_mps=speed_mps).at(times)


def point(state: PersonState, name: str) -> np.ndarray:
    return state.keypoints_world[:, KEYPOINTS.index(name)]


def hips(state: PersonState) -> np.ndarray:
    return (point(state, "left_hip") + point(state, "right_hip")) / 2


def angle(state: PersonState, joint: str, which: int = 0) -> np.ndarray:
    return np.rad2deg(state.angle_rad[:, JOINTS.index(joint), which])


@pytest.fixture(scope="module")
def body() -> SimulatedBody:
    return build_body(BodyShapeSettings(sex=0.4))


@pytest.fixture(scope="module", params=PATHS)
def walked(request: pytest.FixtureRequest, body: SimulatedBody) -> PersonState:
    path, speed = PATHS[request.param]
    return walk(body, path, speed, np.arange(-2.0, 14.0, 1 / HZ))


@pytest.fixture(scope="module")
def circle(body: SimulatedBody) -> PersonState:
    return walk(body, *PATHS["circle"], np.arange(0.0, 20.0, 1 / HZ))


def held(track: np.ndarray, height_m: float) -> list[slice]:
    """Stretches of at least a twentieth of a second in which a point stays low and hardly moves."""
    speed = np.linalg.norm(np.gradient(track, 1 / HZ, axis=0), axis=-1)
    still = (speed < 0.08) & (track[:, 2] < height_m)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    return [slice(a, b) for a, b in edges.reshape(-1, 2) if b - a > HZ / 20]


@pytest.mark.parametrize("side", ["left", "right"])
def test_planted_feet_do_not_slide(walked: PersonState, side: str) -> None:
    toe, heel = point(walked, f"{side}_big_toe"), point(walked, f"{side}_heel")
    stances = held(toe, 0.04)
    assert len(stances) >= 3
    # from the whole foot on the floor to the toe's leaving it, whatever the heel does
    assert max(np.ptp(toe[s, :2], axis=0).max() for s in stances) < 5e-3
    flats = [s for s in held(heel, 0.06) if s.stop - s.start > HZ / 10]
    assert len(flats) >= 3
    assert max(np.ptp(heel[s, :2], axis=0).max() for s in flats) < 5e-3


def test_there_is_always_a_planted_foot(walked: PersonState) -> None:
    planted = np.zeros(len(walked.moved), bool)
    for name in ("left_big_toe", "right_big_toe", "left_heel", "right_heel"):
        for stance in held(point(walked, name), 0.06):
            planted[stance] = True
    assert planted[10:-10].mean() > 0.97


def test_feet_stay_above_the_floor(body: SimulatedBody, walked: PersonState) -> None:
    lowest = body.vertices(walked.moved[::67])[..., 2].min(axis=1)
    assert lowest.min() > -5e-3
    assert lowest.max() < 5e-3


def test_nothing_jumps(walked: PersonState) -> None:
    acceleration = np.linalg.norm(np.diff(walked.keypoints_world, 2, axis=0), axis=-1) * HZ**2
    joints = [KEYPOINTS.index(f"{s}_{j}") for s in ("left", "right") for j in ("hip", "shoulder", "elbow", "wrist")]
    assert acceleration[:, joints].max() < 40.0
    assert np.percentile(acceleration, 99.9) < 150.0


def test_knees_bend_one_way(walked: PersonState) -> None:
    for side in ("left", "right"):
        assert angle(walked, f"{side}_knee").min() > 1.0
        assert np.abs(angle(walked, f"{side}_knee", 1)).max() < 1e-6


def test_circle_speed_radius_and_heading(circle: PersonState) -> None:
    radius = np.linalg.norm(hips(circle)[:, :2], axis=-1)
    assert np.abs(radius - 1.5).max() < 0.04
    turned = np.unwrap(np.arctan2(hips(circle)[:, 1], hips(circle)[:, 0]))
    speed = (turned[-1] - turned[0]) * 1.5 / (20.0 - 1 / HZ)
    assert speed == pytest.approx(1.35, rel=0.02)
    across = point(circle, "left_hip") - point(circle, "right_hip")
    # walking counter-clockwise the left hip is on the inside
    assert np.sum(across[:, :2] * hips(circle)[:, :2], axis=-1).max() < 0


@pytest.mark.parametrize("speed", [0.6, 1.0, 1.6])
def test_straight_speed_is_as_asked(body: SimulatedBody, speed: float) -> None:
    times = np.arange(0, 9 / speed, 1 / HZ)
    way = walk(body, {"shape": "line", "start_m": (0, 0), "end_m": (0, 9)}, speed, times)
    on = (hips(way)[:, 1] > 2.5) & (hips(way)[:, 1] < 6.5)
    track, t_s = hips(way)[on, 1], times[on]
    assert (track[-1] - track[0]) / (t_s[-1] - t_s[0]) == pytest.approx(speed, rel=0.02)


def test_line_starts_and_ends_standing(body: SimulatedBody) -> None:
    way = walk(body, *PATHS["line"], np.array([-5.0, 0.0, 20.0, 30.0]))
    assert np.allclose(hips(way)[:2, :2], [-2.0, 0.5], atol=0.03)
    assert np.allclose(hips(way)[2:, :2], [2.5, 1.5], atol=0.03)
    assert np.allclose(way.keypoints_world[2], way.keypoints_world[3], atol=1e-9)
    feet = point(way, "left_ankle")[2] - point(way, "right_ankle")[2]
    ahead = np.array([4.5, 1.0]) / np.hypot(4.5, 1.0)
    assert abs(feet[:2] @ ahead) < 0.03


def test_joint_ranges_are_human(body: SimulatedBody) -> None:
    way = walk(body, {"shape": "line", "start_m": (0, 0), "end_m": (12, 0)}, 1.35, np.arange(3.0, 7.0, 1 / HZ))
    for side in ("left", "right"):
        hip, knee, ankle = (angle(way, f"{side}_{j}") for j in ("hip", "knee", "ankle"))
        assert 35 < np.ptp(hip) < 55
        assert hip.min() < -5
        assert 55 < knee.max() < 70
        assert knee.min() < 10
        assert 25 < np.ptp(ankle) < 50
        arm = point(way, f"{side}_elbow") - point(way, f"{side}_shoulder")
        assert 20 < np.ptp(np.rad2deg(np.arctan2(arm[:, 0], -arm[:, 2]))) < 50
    assert 0.02 < np.ptp(hips(way)[:, 2]) < 0.06
    # the arm goes forward with the other side's leg
    arm = point(way, "left_wrist")[:, 0] - hips(way)[:, 0]
    assert np.corrcoef(arm, point(way, "right_ankle")[:, 0] - hips(way)[:, 0])[0, 1] > 0.7


def test_half_a_cycle_later_is_the_mirror_image(body: SimulatedBody) -> None:
    times = np.arange(4.0, 6.5, 1 / HZ)
    way = walk(body, {"shape": "line", "start_m": (0, 0), "end_m": (12, 0)}, 1.2, times)
    left, right = (angle(way, f"{side}_knee") for side in ("left", "right"))
    shifts = np.arange(30, 90)
    gaps = [np.abs(left[s:] - right[:-s]).max() for s in shifts]
    assert min(gaps) < 3.0


def test_step_length_grows_with_speed_and_leg(body: SimulatedBody) -> None:
    def step_m(who: SimulatedBody, speed: float) -> float:
        way = walk(who, {"shape": "line", "start_m": (0, 0), "end_m": (9, 0)}, speed, np.arange(2, 6, 1 / HZ))
        places = [point(way, "left_ankle")[s, 0].mean() for s in held(point(way, "left_heel"), 0.06)]
        return float(np.median(np.diff(np.unique(np.round(places, 1)))) / 2)

    child = build_body(BodyShapeSettings(age_years=9, height_m=1.3))
    assert step_m(body, 0.8) < step_m(body, 1.5)
    assert step_m(child, 1.2) < step_m(body, 1.2)


def test_sideways_faces_one_way_and_never_crosses(body: SimulatedBody) -> None:
    way = walk(body, *PATHS["sideways"], np.arange(0, 12, 1 / HZ))
    assert (point(way, "nose")[:, 1] > hips(way)[:, 1]).all()
    # facing +Y the left foot stays on the -X side
    assert (point(way, "right_ankle")[:, 0] - point(way, "left_ankle")[:, 0] > 0.08).all()
    assert np.ptp(hips(way)[:, 0]) == pytest.approx(3.0, abs=0.05)


def test_random_way_stays_in_its_area(body: SimulatedBody) -> None:
    way = walk(body, *PATHS["random"], np.arange(0, 60, 0.1))
    assert (hips(way)[:, :2] > [-2.0, -1.5]).all()
    assert (hips(way)[:, :2] < [2.0, 1.5]).all()


@pytest.mark.parametrize(
    "settings", [BodyShapeSettings(age_years=5), BodyShapeSettings(height_m=2.0), BodyShapeSettings(random_seed=1)]
)
def test_every_body_walks(settings: BodyShapeSettings) -> None:
    who = build_body(settings)
    fastest = 0.98 * np.sqrt(0.5 * 9.81 * who.points_rest["left_hip"][2])
    for speed in (0.3, float(min(fastest, 2.2))):
        way = walk(who, {"shape": "line", "start_m": (0, 0), "end_m": (9, 0)}, speed, np.arange(1.0, 4.0, 0.025))
        lowest = who.vertices(way.moved[::9])[..., 2].min(axis=1)
        assert np.abs(lowest).max() < 5e-3
        for side in ("left", "right"):
            assert angle(way, f"{side}_knee").min() > 1.0
            assert angle(way, f"{side}_knee").max() < 95.0


# --- standing


FEET = ("left_ankle", "right_ankle", "left_big_toe", "right_big_toe", "left_heel", "right_heel")
STANDING = ("tpose", "idle", "reach", "squat", "wave", "overhead", "sit")


def test_tpose_arms_are_exactly_horizontal_and_straight(body: SimulatedBody) -> None:
    state = person(body, kind="tpose", position_m=(1.5, -0.5), heading_deg=90).at([0.0, 12.0])
    for side, sign in (("left", -1.0), ("right", 1.0)):
        shoulder, elbow, wrist = (point(state, f"{side}_{j}") for j in ("shoulder", "elbow", "wrist"))
        assert np.allclose(shoulder[:, 2], wrist[:, 2], atol=1e-9)
        assert np.allclose(shoulder[:, 2], elbow[:, 2], atol=1e-9)
        # facing +Y, the right arm points along +X
        assert np.allclose((wrist - shoulder)[:, 1], 0.0, atol=1e-9)
        assert ((wrist - shoulder)[:, 0] * sign > 0.4).all()
        assert np.allclose(angle(state, f"{side}_shoulder", 1), 90.0, atol=1e-6)
        assert np.allclose(angle(state, f"{side}_elbow", 0), 0.0, atol=1e-6)
    assert np.allclose(hips(state)[:, :2], [1.5, -0.5], atol=1e-9)


@pytest.mark.parametrize("kind", STANDING)
def test_feet_stay_and_stand_on_the_floor(body: SimulatedBody, kind: str) -> None:
    state = person(body, kind=kind, heading_deg=-40).at(np.linspace(-1.0, 9.0, 60))
    for name in FEET:
        # the heel's skin is pulled a little by the shank
        limit = 1e-9 if name.endswith("ankle") else 2e-3
        assert np.ptp(point(state, name), axis=0).max() < limit, name
    lowest = body.vertices(state.moved[::6])[..., 2].min(axis=1)
    assert (np.abs(lowest) < 1e-3).all()


@pytest.mark.parametrize("kind", [*STANDING, "walk"])
def test_same_seed_same_bytes_and_any_order_of_times(body: SimulatedBody, kind: str) -> None:
    times = np.array([0.0, 3.3, 1.1, -0.4])
    one, same = (person(body, kind=kind).at(times) for _ in range(2))
    assert one.moved.tobytes() == same.moved.tobytes()
    assert one.angle_rad.tobytes() == same.angle_rad.tobytes()
    alone = person(body, kind=kind).at([1.1])
    assert np.allclose(alone.keypoints_world[0], one.keypoints_world[2], atol=1e-12)


@pytest.mark.parametrize("kind", ["idle", "reach", "wave", "walk"])
def test_other_seed_other_motion(body: SimulatedBody, kind: str) -> None:
    one, other = (person(body, seed=seed, kind=kind).at([1.0, 2.0]) for seed in (1, 2))
    assert np.abs(one.keypoints_world - other.keypoints_world).max() > 1e-3


@pytest.mark.parametrize("kind", STANDING)
def test_motion_is_smooth(body: SimulatedBody, kind: str) -> None:
    step = 1e-3
    state = person(body, kind=kind).at(np.arange(0.0, 6.0, step))
    speed = np.linalg.norm(np.diff(state.keypoints_world, axis=0), axis=-1) / step
    assert speed.max() < 6.0
    jump = np.abs(np.diff(state.keypoints_world, 2, axis=0)).max() / step**2
    assert jump < 200.0


def test_idle_sways_by_millimetres(body: SimulatedBody) -> None:
    state = person(body, kind="idle").at(np.arange(0, 60, 0.1))
    sway = np.std(hips(state), axis=0)
    assert (sway[:2] > 1e-3).all()
    assert (sway[:2] < 2e-2).all()
    still = person(body, kind="idle", sway=0).at(np.arange(0, 6, 0.1))
    assert np.ptp(still.keypoints_world, axis=0).max() < 1e-9


def test_squat_reaches_its_depth_over_the_feet(body: SimulatedBody) -> None:
    state = person(body, kind="squat", period_s=2.0, knee_flexion_deg=100).at(np.linspace(0, 2, 41))
    for side in ("left", "right"):
        knee = angle(state, f"{side}_knee", 0)
        assert knee.max() == pytest.approx(100, abs=2)
        assert knee.min() < 10
    assert angle(state, "left_hip", 0).max() > 70
    middle = state.keypoints_world[20]
    feet_x = [middle[KEYPOINTS.index(n), 0] for n in ("left_heel", "left_big_toe")]
    trunk = middle[[KEYPOINTS.index(n) for n in ("left_hip", "left_shoulder", "left_knee")], 0].mean()
    assert feet_x[0] < trunk < feet_x[1]


def test_squat_is_mirror_symmetric(body: SimulatedBody) -> None:
    state = person(body, kind="squat").at(np.linspace(0, 3, 9))
    mirrored = state.keypoints_world[:, KEYPOINTS.mirror] * [1, -1, 1]
    assert np.abs(mirrored - state.keypoints_world).max() < 5e-3
    for joint in JOINTS:
        if joint.startswith("left_"):
            other = state.angle_rad[:, JOINTS.index("right_" + joint[5:])]
            assert np.abs(np.rad2deg(state.angle_rad[:, JOINTS.index(joint)] - other)).max() < 1.0, joint


def test_reach_comes_far_and_differs_each_time(body: SimulatedBody) -> None:
    state = person(body, kind="reach", period_s=2.0).at(np.arange(0, 12, 2.0) + 0.42 * 2.0)
    arm = [np.linalg.norm(point(state, a) - point(state, b), axis=-1) for a, b in
           (("right_shoulder", "right_wrist"), ("right_shoulder", "right_elbow"), ("right_elbow", "right_wrist"))]  # fmt: skip
    assert (arm[0] / (arm[1] + arm[2]) > 0.7).all()
    assert ((point(state, "right_wrist") - point(state, "right_shoulder"))[:, 0] > 0.2).all()
    assert np.ptp(point(state, "right_wrist"), axis=0).max() > 0.1


@pytest.mark.parametrize("side", ["left", "right"])
def test_wave_holds_the_hand_up_on_its_side(body: SimulatedBody, side: str) -> None:
    state = person(body, kind="wave", side=side).at(np.linspace(0, 3, 30))
    assert (point(state, f"{side}_wrist")[:, 2] > point(state, f"{side}_shoulder")[:, 2] + 0.1).all()
    assert np.ptp(point(state, f"{side}_wrist"), axis=0).max() > 0.1
    other = "left" if side == "right" else "right"
    assert (point(state, f"{other}_wrist")[:, 2] < point(state, f"{other}_elbow")[:, 2]).all()


def test_arms_come_up_over_the_head_and_down_again(body: SimulatedBody) -> None:
    state = person(body, kind="overhead", period_s=2.0).at([0.0, 1.0, 2.0])
    for side in ("left", "right"):
        above_m = (point(state, f"{side}_wrist") - point(state, "nose"))[:, 2]
        assert above_m[1] > 0.25 and (above_m[[0, 2]] < -0.5).all()


def test_the_seated_have_level_thighs_and_upright_trunks(body: SimulatedBody) -> None:
    state = person(body, kind="sit", period_s=4.0, heading_deg=120).at(np.linspace(0, 4, 41))
    knee = angle(state, "left_knee", 0)
    assert knee[[0, -1]] == pytest.approx([0, 0], abs=12) and 80 < knee.max() < 105
    seated = int(np.argmax(knee))
    thigh = point(state, "left_hip")[seated] - point(state, "left_knee")[seated]
    assert abs(thigh[2]) < 0.1 and np.linalg.norm(thigh[:2]) > 0.3
    assert (point(state, "nose") - point(state, "left_hip"))[seated, 2] > 0.5


def test_who_turns_on_the_spot_always_stands_on_a_foot(body: SimulatedBody) -> None:
    t_s = np.linspace(0, 4, 401)
    state = person(body, kind="turn", period_s=4.0, position_m=(0.3, -0.2)).at(t_s)
    ankles = np.stack([point(state, f"{side}_ankle") for side in ("left", "right")], axis=1)
    speed = np.linalg.norm(np.gradient(ankles, t_s, axis=0), axis=-1)
    assert (speed.min(axis=1) < 1e-6).mean() > 0.9 and speed.max() > 0.5
    across = point(state, "left_hip") - point(state, "right_hip")
    heading = np.unwrap(np.arctan2(across[:, 1], across[:, 0]))
    assert np.degrees(heading[-1] - heading[0]) == pytest.approx(360, abs=1) and (np.diff(heading) > -1e-9).all()
    lowest = body.vertices(state.moved[::40])[..., 2].min(axis=1)
    assert (lowest > -2e-3).all() and np.linalg.norm(ankles[..., :2] - [0.3, -0.2], axis=-1).max() < 0.2


def test_segments_and_angles_belong_together(body: SimulatedBody) -> None:
    state = person(body, kind="reach").at([0.9])
    rotation = state.world_from_segment.matrix()[0]
    thigh, shank = (rotation[SEGMENTS.index(f"left_{s}")] for s in ("thigh", "shank"))
    bend = np.rad2deg(np.arccos(np.clip(thigh[:, 1] @ shank[:, 1], -1, 1)))
    assert bend == pytest.approx(angle(state, "left_knee", 0)[0], abs=1e-6)
    assert np.allclose(state.world_from_segment.xyz[0, SEGMENTS.index("left_shank")], point(state, "left_knee")[0], atol=1e-9)
